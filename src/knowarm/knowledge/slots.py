"""Slots: what each one describes, an object with its colour or a condition, and how in words."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from knowarm.errors import Argument, UserError, unknown_name
from knowarm.knowledge.config import FULL, KnowledgeConfig
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.graph.denials import without_derived
from knowarm.knowledge.graph.graph import KnowledgeGraph, gamma
from knowarm.knowledge.graph.homonyms import object_ids
from knowarm.knowledge.graph.terms import label_of, local_name
from knowarm.knowledge.vectors.source import Facet, SentencePart
from knowarm.questions import Condition, ObjectColour

Sentence = list[SentencePart]
"""The labels of a sentence in their order."""
_Subgraph = tuple[KnowledgeGraph, str | None]
"""The subgraph of a facet, and the graph's name of its colour if it has one."""


class SlotLabels(NamedTuple):
    """What a slot says."""

    sentence: Sentence
    value: SentencePart | None  # The label of its colour, or of the value in a query
    rest: Sentence  # The labels beside it


class Described(NamedTuple):
    """What S slots say."""

    slots: list[SlotLabels]
    values: Sentence  # Labels that the value of a slot is centred among
    graph: KnowledgeGraph  # The graph that they are described by


def facet_subgraphs(
    facets: Sequence[Facet], graph: KnowledgeGraph, config: KnowledgeConfig, seed: int
) -> tuple[KnowledgeGraph, list[_Subgraph]]:
    """Return the graph that the slots of a scene are described by, and their subgraphs in it.

    Placebos change the graph, or the facets.
    """
    source = config.source
    graph = source.change_graph(graph, seed)
    named = []
    for name, colour, _ in facets:
        colour = colour and config.graph_name(colour)
        named.append(Facet(config.graph_name(name), colour))
    subgraphs = []
    for facet in source.change_facets(named, graph, config.colour_relation, seed):
        around = _around(graph, facet.object, config)
        subgraphs.append(facet_subgraph(around, facet, config.colour_relation))
    return graph, subgraphs


def describe_facets(
    facets: Sequence[Facet], graph: KnowledgeGraph, config: KnowledgeConfig, seed: int
) -> Described:
    """Return the sentences of the slots of a scene, and the colours."""
    graph, subgraphs = facet_subgraphs(facets, graph, config, seed)
    colours = Sentence()
    if config.detail == "full":  # every colour of the graph
        rows = graph.relations == graph.relation_id(config.colour_relation)
        names = graph.names.at(np.unique(graph.tails[rows]))
        colours = [entity_part(graph, name) for name in names]
    slots = []
    for subgraph, colour in subgraphs:
        labels = _labels_of_slot(sentence_parts(subgraph, config), colour)
        if labels.value is not None and any(h == t == colour for h, _, t in subgraph):
            # An object with the name of its colour, such as an orange, keeps its own label.
            labels.rest[:] = labels.sentence
            labels.rest.remove(labels.value)
        slots.append(labels)
    return Described(slots, colours, graph)


def describe_conditions(
    conditions: Sequence[Condition],
    graph: KnowledgeGraph,
    config: KnowledgeConfig,
    seed: int,
) -> Described:
    """Return the labels of each condition, and its value where there are others beside it.

    Raises:
        UserError: the graph describes none of the conditions.
    """
    if config.hops and not any(_entity(graph, c, config) for c in conditions):
        raise UserError(
            f"The graph describes none of the {len(conditions)} conditions of the queries, such as "
            f"{conditions[0].name!r}. Set graph to the one that the queries were made "
            "from."
        )
    graph = config.source.change_graph(graph, seed)
    slots = []
    values = Sentence()
    for condition in config.source.change_conditions(conditions):
        value = _entity(graph, condition, config) or condition.value
        values.append(entity_part(graph, value))
        labels = _labels_of_slot(_condition_parts(graph, condition, config), value)
        if not labels.rest:
            labels = SlotLabels(labels.sentence, None, labels.sentence)
        slots.append(labels)
    return Described(slots, values, graph)


def slots_of(
    config: KnowledgeConfig, facets: Sequence[ObjectColour]
) -> tuple[Facet, ...]:
    """Return the slots in the order of the facets: one per object (partial) or facet (full)."""
    is_partial = config.detail == "partial"
    slots = (Facet(name, None if is_partial else colour) for name, colour in facets)
    return tuple(dict.fromkeys(slots))


def _labels_of_slot(parts: Sentence, name: str | None) -> SlotLabels:
    """Return the labels of a sentence, with the value of this name apart, if there is one."""
    rest = [part for part in parts if part.name != name]
    value = None
    for part in parts:
        if part.name == name and value is None:
            value = part
    return SlotLabels(parts, value, rest)


def _condition_parts(
    graph: KnowledgeGraph, condition: Condition, config: KnowledgeConfig
) -> Sentence:
    """Return the labels that describe a condition: its own, then those of Gamma of its value.

    A value that the graph does not hold, such as a colour without facts, has its own label only.
    """
    names = graph.relation_names
    same_name = names.at(names.find_local(condition.relation))
    relation = [*same_name, condition.relation][0]
    value = _entity(graph, condition, config)
    parts = relation_parts(graph, relation, config)
    parts.append(entity_part(graph, value or condition.value))
    if config.hops > 0 and value is not None:
        around = _around(graph, value, config)
        if len(around):
            parts += sentence_parts(around, config)
    return parts


def _entity(
    graph: KnowledgeGraph, condition: Condition, config: KnowledgeConfig
) -> str | None:
    """Return the graph's name of a condition's value, or None if the graph does not hold it."""
    entity = graph.find_entity(config.graph_name(condition.value))
    return None if entity is None else graph.names[entity]


def graph_facets(
    objects: Sequence[str], graph: KnowledgeGraph, colour_relation: str = "hasColor"
) -> list[tuple[str, str]]:
    """Return (object, colour) pairs with the colours that the graph gives each object, by name.

    An object without a colour gets the pair (object, ""), which only detail "partial" accepts.
    """
    names = graph.relation_names
    relations = names.find_all([colour_relation]) or names.find_local(colour_relation)
    pairs = list[tuple[str, str]]()
    for name, entity in zip(objects, object_ids(graph, objects), strict=True):
        rows = graph.out_rows(entity)
        tails = graph.tails[rows][np.isin(graph.relations[rows], relations)]
        for tail in np.sort(tails):
            pairs.append((name, local_name(graph.names[tail])))
        if not len(tails):
            pairs.append((name, ""))
    return pairs


def facet_subgraph(
    around: KnowledgeGraph, facet: Facet, colour_relation: str
) -> _Subgraph:
    """Select the subgraph of a facet, by names of the graph: Gamma with the facet's colour only.

    Returns the graph's name of the colour as well, if the facet has one.
    """
    entity = around.entity_id(facet.object)
    relation = around.find_relation(colour_relation)
    if relation is None and facet.colour is not None:
        relations = map(local_name, around.relation_names)
        unknown = unknown_name("colour relation", colour_relation, relations)
        raise UserError(
            f"{unknown} For an agent that does not describe colours pass ",
            Argument("knows.detail", "partial"),
            "; if the graph has colours, name its relation by ",
            Argument("knows.colour_relation", "RELATION"),
            ".",
        )
    colours = (around.heads == entity) & (around.relations == relation)
    kept = ~colours
    colour = None
    if facet.colour is not None:
        row = _colour_row(around, np.flatnonzero(colours), facet, facet.colour)
        kept[row] = True
        colour = around.names[around.tails[row]]
    return around.rows(kept, nodes=np.array([entity])), colour


def _colour_row(
    around: KnowledgeGraph, rows: np.ndarray, facet: Facet, wanted: str
) -> int:
    """Return the row of the facet's colour fact among the object's colour facts."""
    if facet.colour_number is not None and len(rows):
        return int(rows[facet.colour_number % len(rows)])
    tails = around.names.at(around.tails[rows])
    for row, tail in zip(rows, tails, strict=True):
        label = label_of(tail, around.labels)
        if wanted in (tail, local_name(tail)) or label_of(wanted, {}) == label:
            return int(row)
    if not tails:
        raise UserError(
            f"{facet.object!r} has no colour in the graph, or none that hops, direction and "
            "relations reach, so detail 'full' cannot describe it. Add its colours to the graph, "
            "let them be reached, or set ",
            Argument("knows.detail", "partial"),
            ".",
        )
    raise UserError(
        f"The graph does not say that {facet.object!r} can be {wanted!r}. "
        f"Its colours there: {', '.join(sorted(map(local_name, tails)))}. "
        "Add that fact to the graph, or use ",
        Argument("knows.detail", "partial"),
        "; if the colours are randomized and the graph has the fixed ones, ",
        Argument("env.colours", "fixed"),
        ".",
    )


def _around(
    graph: KnowledgeGraph, entity: str, config: KnowledgeConfig
) -> KnowledgeGraph:
    """Select Gamma of an entity."""
    return gamma(
        graph,
        [entity],
        hops=config.hops,
        direction=config.direction,
        relations=config.relations,
        max_degree=config.max_degree,
    )


def sentence_parts(graph: KnowledgeGraph, config: KnowledgeConfig = FULL) -> Sentence:
    """Return the labels of a subgraph in the order of its triples: head, relation, tail names."""
    if not len(graph):
        asked = ", ".join(graph.entities[:8]) or "no entity"
        raise UserError(
            f"The subgraph of {asked} is empty: it holds no fact to describe. "
            "Add facts about it, allow more relations, or take ",
            Argument("knows.direction", "both"),
            ".",
        )
    parts = Sentence()
    for head, relation, tail in graph:
        parts.append(entity_part(graph, head))
        parts += relation_parts(graph, relation, config)
        parts.append(entity_part(graph, tail))
    return parts


def relation_parts(
    graph: KnowledgeGraph, relation: str, config: KnowledgeConfig
) -> Sentence:
    """Return the label of an edge, or nothing where the sentence leaves it out."""
    words = {local_name(relation): label_of(relation, graph.labels)} | config.templates
    label = words.get(relation, words[local_name(relation)])
    if not config.relation_words or not label:
        return []
    return [SentencePart(relation, label.lower(), is_relation=True)]


def entity_part(graph: KnowledgeGraph, name: str) -> SentencePart:
    """Return the label of a node."""
    return SentencePart(name, label_of(name, graph.labels), is_relation=False)


def sentence(graph: KnowledgeGraph, config: KnowledgeConfig = FULL) -> str:
    """Return the sentence of a subgraph, e.g. "mug has color red mug has shape cylindrical"."""
    return words_of(sentence_parts(graph, config))


def words_of(parts: Sentence) -> str:
    """Return a sentence as text."""
    return " ".join(part.label for part in parts)


def graph_parts(graph: KnowledgeGraph, *, relation_words: bool) -> Sentence:
    """Return every label of a graph: its entities and, if they are included, its relations."""
    parts = [entity_part(graph, name) for name in graph.entities]
    if relation_words:
        for name in graph.relations_used:
            label = label_of(name, graph.labels)
            parts.append(SentencePart(name, label, is_relation=True))
    return parts


def _subgraphs(
    config: KnowledgeConfig, facets: Sequence[ObjectColour], run_seed: int
) -> tuple[KnowledgeGraph, dict[str, KnowledgeGraph]]:
    """Return the graph that slots are described by, and the subgraph of each by its name."""
    slots = slots_of(config, facets)
    graph = without_derived(read_graph(config.graph))
    if not slots:
        return graph, {}
    seed = config.source.draw_seed(config.seed, run_seed)
    graph, subgraphs = facet_subgraphs(slots, graph, config, seed)
    by_name = {}
    for slot, (subgraph, _) in zip(slots, subgraphs, strict=True):
        by_name[slot.name] = subgraph
    return graph, by_name


def scene_subgraph(
    config: KnowledgeConfig, facets: Sequence[ObjectColour], *, run_seed: int = 0
) -> KnowledgeGraph:
    """Return the union of the slots' subgraphs."""
    graph, by_name = _subgraphs(config, facets, run_seed)
    subgraphs = [graph.rows(np.empty(0, np.int64)), *by_name.values()]
    return KnowledgeGraph(
        graph.names,
        graph.relation_names,
        np.concatenate([subgraph.triples for subgraph in subgraphs]),
        nodes=np.concatenate([subgraph.nodes for subgraph in subgraphs]),
        labels=graph.labels,
    )


def scene_sentences(
    config: KnowledgeConfig, facets: Sequence[ObjectColour], *, run_seed: int = 0
) -> dict[str, str]:
    """Return the sentence of each slot, by the slot's name."""
    _, by_name = _subgraphs(config, facets, run_seed)
    return {name: sentence(subgraph, config) for name, subgraph in by_name.items()}
