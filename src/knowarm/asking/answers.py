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
from knowarm.knowledge.graph.graph import KnowledgeGraph, Triple
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
    conditions = frozenset[str]().union(*by_conditions)
    triples = list[Triple]()
    for condition in conditions:
        relation, _, value = condition.partition(" ")
        if value:
            triples.append(("it", relation, value))
    graph = graph_of(triples)
    colours = sorted(
        value for _, relation, value in triples if relation == COLOUR_RELATION
    )
    text = read_plain(
        prompt, Vocabulary(graph, graph.heads[:1], colours), lambda _: set()
    )
    row = by_conditions.get(frozenset(text.replace('"', "").split(AND)))
    if row is None:
        raise UserError(
            f"The policy knows no query {text!r}, as which {prompt!r} is read."
        )
    return row


def _reading(
    graph: KnowledgeGraph,
    entities: Mapping[str, int | None],
    facets: Sequence[ObjectColour],
    text: str,
) -> str:
    if _SPARQL.match(text):
        return text
    colours = dict.fromkeys(colour for _, colour in facets)
    reader = QuestionReader(text, graph, set(colours))
    exact = None
    try:
        reader.whole()
        if _evidence(graph, entities, facets, text):
            return text
    except AmbiguousNameError:
        raise
    except UserError as error:
        exact = error

    def holders(question: str) -> set[int]:
        names = {name for name, _ in _evidence(graph, entities, facets, question)}
        return {
            entity
            for name, entity in entities.items()
            if name in names and entity is not None
        }

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
    if _SPARQL.match(text):
        part = _sparql(graph, text)
    else:
        colours = {colour for _, colour in facets}
        part = QuestionReader(text, graph, colours).whole()
    evidence = dict[ObjectColour, Evidence]()
    for name, colour in facets:
        entity = entities[name]
        reason = None if entity is None else part(entity, colour)
        if reason is not None:
            evidence[name, colour] = reason
    return evidence


def words(
    graph: KnowledgeGraph,
    facets: Sequence[ObjectColour],
    names: Mapping[str, str] | None = None,
) -> Words:
    """Return what a graph can be asked about objects: colours first, then its facts.

    Args:
        graph, facets, names: as of `answer`.
    """
    objects: dict[str, dict[str, list[str]]] = {COLOUR_RELATION: {}}
    for name, colour in facets:
        objects[COLOUR_RELATION].setdefault(colour, []).append(name)
    names_of_objects = dict.fromkeys(name for name, _ in facets)
    for name, entity in _entities(graph, names_of_objects, names or {}).items():
        if entity is None:
            continue
        for row in graph.out_rows(entity):
            tail = graph.tails[row]
            relation = graph.relation_names.short(graph.relations[row])
            if (
                graph.names[tail].startswith(('"', "_:"))
                or local_name(relation) == COLOUR_RELATION
            ):
                continue
            value = graph.names.short(tail)
            objects.setdefault(relation, {}).setdefault(value, []).append(name)
    return objects


def _entities(
    graph: KnowledgeGraph, objects: Collection[str], names: Mapping[str, str]
) -> dict[str, int | None]:
    """Return the entity of each object, None of those that the graph does not describe."""
    for name in names:
        if name not in objects:
            raise unknown_name("object of the task", name, objects)
    entities = dict[str, int | None]()
    for name in objects:
        if name in names:
            entities[name] = graph.entity_id(names[name])
        else:
            entities[name] = graph.described(name)
    if set(entities.values()) <= {None}:
        example = "mug=MyMug"
        for name in objects:
            near = graph.entity_spellings.near(name)
            if near:
                example = f"{name}={near[0]}"
                break
        raise UserError(
            f"The graph describes none of the {len(entities)} objects of the task, such as "
            f"{next(iter(entities))!r}. Give its names for them, such as ",
            Argument("names", example),
            ", or give another graph.",
        )
    return entities


def _sparql(graph: KnowledgeGraph, text: str) -> Part:
    """Return what a SPARQL query selects as ?object and, if it does, in the colour ?colour.

    It runs once per facet, whose colour the graph then states, as the image shows it.
    """
    query = SparqlQuery(graph, text)
    ids = graph.relation_names.find_local(COLOUR_RELATION)
    relations = {COLOUR_RELATION, *map(graph.relation_names.__getitem__, ids)}

    def evidence(entity: int, colour: str | None) -> Evidence | None:
        shown = list[str]()
        if colour is not None:
            shown = [graph.names[i] for i in graph.alike(colour)] or [colour]
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
            values = dict(zip(result.columns, row, strict=True))
            if values["object"] == graph.names[entity] and _in_colour(values, colour):
                return tuple(
                    f"?{name} = {local_name(value)}" for name, value in values.items()
                )
        return None

    return evidence


def _in_colour(values: Mapping[str, str], colour: str | None) -> bool:
    """Return whether all colours that a row selects are the one that is shown."""
    for name, value in values.items():
        is_colour = name != "object" and value != ""
        if is_colour and name_key(local_name(value)) != name_key(colour or ""):
            return False
    return True
