"""Answers to questions in words or SPARQL, with their evidence."""

import re
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from knowarm.asking.expressions import Evidence, Part, QuestionReader
from knowarm.asking.plain_words import read_plain
from knowarm.asking.vocabulary import Vocabulary
from knowarm.errors import Argument, UserError, unknown_name
from knowarm.knowledge.graph.builder import graph_of
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.names import AmbiguousNameError
from knowarm.knowledge.graph.terms import local_name, name_key
from knowarm.knowledge.queries.sparql import SparqlQuery
from knowarm.questions import AND, COLOUR_RELATION, ObjectColour

_SPARQL = re.compile(r"\s*(PREFIX|BASE|SELECT|ASK|CONSTRUCT|DESCRIBE)\b", re.IGNORECASE)


Words = Mapping[str, Mapping[str, Sequence[str]]]
"""Objects by relation and value."""


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
    text = _reading(graph, entities, facets, text)
    evidence = _evidence(graph, entities, facets, text)
    if not evidence:
        raise UserError(
            f"No object of the task answers the question {text!r}. Ask another one, or add the "
            "missing triple to the graph."
        )
    return Answers(text, np.array([facet in evidence for facet in facets]), evidence)


def reading(
    graph: KnowledgeGraph,
    facets: Sequence[ObjectColour],
    text: str,
    names: Mapping[str, str] | None = None,
) -> str:
    """Return a question as `answer` reads it: plain English becomes conditions of the graph."""
    entities = _entities(graph, dict.fromkeys(name for name, _ in facets), names or {})
    return _reading(graph, entities, facets, text)


def row_of(prompt: str, rows: Sequence[str]) -> str:
    """Return the query among rows, "usedFor drinking and hasColor blue", that a prompt means.

    Raises:
        UserError: the prompt is not understood, or means none of them.
    """
    if prompt in rows:
        return prompt
    by_conditions = {frozenset(row.split(AND)): row for row in rows}
    pairs = {tuple(c.split(" ", 1)) for each in by_conditions for c in each if " " in c}
    graph = graph_of([("it", relation, value) for relation, value in pairs])
    colours = sorted(value for relation, value in pairs if relation == COLOUR_RELATION)
    text = read_plain(prompt, Vocabulary(graph, graph.heads[:1], colours), lambda _: set())
    found = by_conditions.get(frozenset(text.replace('"', "").split(AND)))
    if found is None:
        raise UserError(f"The policy knows no query {text!r}, as which {prompt!r} is read.")
    return found


def _reading(
    graph: KnowledgeGraph,
    entities: Mapping[str, int | None],
    facets: Sequence[ObjectColour],
    text: str,
) -> str:
    if _SPARQL.match(text):
        return text
    colours = dict.fromkeys(colour for _, colour in facets)
    reader, exact = QuestionReader(text, graph, {*colours}), None
    try:
        reader.whole()
        if _evidence(graph, entities, facets, text):
            return text
    except AmbiguousNameError:
        raise
    except UserError as error:
        exact = error

    def holders(question: str) -> set[int]:
        found = _evidence(graph, entities, facets, question)
        return {entity for name, _ in found if (entity := entities[name]) is not None}

    known = [entity for entity in entities.values() if entity is not None]
    try:
        plain = read_plain(text, Vocabulary(graph, known, colours, entities), holders)
    except UserError as error:
        if exact is None:
            return text
        raise exact if reader.has_relation else error from None
    if exact is None:
        return plain if holders(plain) else text
    if reader.has_relation and not holders(plain):
        raise exact  # it names the values that there are
    return plain


def _evidence(
    graph: KnowledgeGraph,
    entities: Mapping[str, int | None],
    facets: Sequence[ObjectColour],
    text: str,
) -> dict[ObjectColour, Evidence]:
    """Return why facets answer a question, of those that do."""
    colours = {colour for _, colour in facets}
    is_sparql = _SPARQL.match(text)
    part = _sparql(graph, text) if is_sparql else QuestionReader(text, graph, colours).whole()
    found = {}
    for name, colour in facets:
        entity = entities[name]
        why = None if entity is None else part(entity, colour)
        if why is not None:
            found[name, colour] = why
    return found


def words(
    graph: KnowledgeGraph, facets: Sequence[ObjectColour], names: Mapping[str, str] | None = None
) -> Words:
    """Return what a graph can be asked about objects: colours first, then its facts.

    Args:
        graph, facets, names: as of `answer`.
    """
    found: dict[str, dict[str, list[str]]] = {COLOUR_RELATION: {}}
    for name, colour in facets:
        found[COLOUR_RELATION].setdefault(colour, []).append(name)
    for name, entity in _entities(graph, dict.fromkeys(n for n, _ in facets), names or {}).items():
        for row in () if entity is None else graph.out_rows(entity):
            tail = graph.names[graph.tails[row]]
            relation = graph.relation_names.short(graph.relations[row])
            if not tail.startswith(('"', "_:")) and local_name(relation) != COLOUR_RELATION:
                value = graph.names.short(graph.tails[row])
                found.setdefault(relation, {}).setdefault(value, []).append(name)
    return found


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
