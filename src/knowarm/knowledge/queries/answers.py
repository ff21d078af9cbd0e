"""Answers to questions in words or SPARQL, with their evidence."""

import re
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from knowarm.errors import Argument, UserError, unknown_name
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import local_name, name_key
from knowarm.knowledge.queries.expressions import Evidence, Part, QuestionReader
from knowarm.knowledge.queries.sparql import SparqlQuery
from knowarm.questions import COLOUR_RELATION, ObjectColour

_SPARQL = re.compile(r"\s*(PREFIX|BASE|SELECT|ASK|CONSTRUCT|DESCRIBE)\b", re.IGNORECASE)


class Answers(NamedTuple):
    """The answers to a question among F facets."""

    question: str
    satisfies: np.ndarray  # Whether each facet answers, (F,) bool
    evidence: dict[ObjectColour, Evidence]  # Why, by answering facet


def answer(
    graph: KnowledgeGraph,
    facets: Sequence[ObjectColour],
    text: str,
    names: Mapping[str, str] | None = None,
) -> Answers:
    """Answer a question by a graph; objects that it does not describe never answer.

    Args:
        graph: the graph.
        facets: objects with their colours.
        text: the question.
        names: the graph's names for objects, where they differ by more than their spelling.

    Raises:
        UserError: the question is malformed, names what the graph does not hold, or has no answer.

    Warns:
        DataWarning: the graph has several entities with the name of an object.
    """
    entities = _entities(graph, dict.fromkeys(name for name, _ in facets), names or {})
    colours = {colour for _, colour in facets}
    part = (
        _sparql(graph, text)
        if _SPARQL.match(text)
        else QuestionReader(text, graph, colours).whole()
    )
    evidence = {}
    for name, colour in facets:
        entity = entities[name]
        why = None if entity is None else part(entity, colour)
        if why is not None:
            evidence[name, colour] = why
    if not evidence:
        raise UserError(
            f"No object of the task answers the question {text!r}. Ask another one, or add the "
            "missing triple to the graph."
        )
    return Answers(text, np.array([facet in evidence for facet in facets]), evidence)


def _entities(
    graph: KnowledgeGraph, objects: Collection[str], names: Mapping[str, str]
) -> dict[str, int | None]:
    """Return the entity of each object, None of those that the graph does not describe."""
    if unknown := [name for name in names if name not in objects]:
        raise unknown_name("object of the task", unknown[0], objects)
    entities = {
        name: graph.entity_id(names[name]) if name in names else graph.described(name)
        for name in objects
    }
    if not any(entity is not None for entity in entities.values()):
        near = {name: graph.entity_spellings.near(name) for name in objects}
        given = next((f"{name}={found[0]}" for name, found in near.items() if found), "mug=MyMug")
        raise UserError(
            f"The graph describes none of the {len(entities)} objects of the task, such as "
            f"{next(iter(entities))!r}. Give its names for them, such as ",
            Argument("names", given),
            ", or give another graph.",
        )
    return entities


def _sparql(graph: KnowledgeGraph, text: str) -> Part:
    """Return what a SPARQL query selects as ?object and, if it does, in the colour ?colour.

    It runs once per facet, whose colour the graph then states, as the image shows it.
    """
    query, names = SparqlQuery(graph, text), graph.relation_names
    relations = {COLOUR_RELATION, *(names[i] for i in names.find_local(COLOUR_RELATION))}

    def evidence(entity: int, colour: str | None) -> Evidence | None:
        known = [] if colour is None else graph.alike(colour)
        shown = [graph.names[i] for i in known] or ([] if colour is None else [colour])
        with query.stating(graph.names[entity], relations, shown):
            result = query.answer()
        other = set(result.columns) - {"object", "colour", "color"}
        if "object" not in result.columns or other:
            raise UserError(
                "A question in SPARQL must select ?object, and may select ?colour, and no more; "
                f"got {', '.join(result.columns) or 'no variables'}. Example: SELECT ?object "
                "WHERE { ?object :usedFor :drinking }"
            )
        for row in result.rows:
            named = dict(zip(result.columns, row, strict=True))
            colours = {n for key, n in named.items() if key != "object" and n}
            fits = all(name_key(local_name(n)) == name_key(colour or "") for n in colours)
            if fits and named["object"] == graph.names[entity]:
                return tuple(f"?{name} = {local_name(value)}" for name, value in named.items())
        return None

    return evidence
