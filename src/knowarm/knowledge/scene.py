"""A graph and the task's (object, colour) pairs go in; what is said about each slot comes out."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.config import KnowledgeConfig
from knowarm.knowledge.facets import Facet, facet_subgraph, slots_of
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.household import household
from knowarm.knowledge.read import read_graph
from knowarm.knowledge.sentence import sentence
from knowarm.knowledge.vectors.placebos import shuffle_tails

Facets = Sequence[tuple[str, str]]
"""The task's (object, colour) pairs, in the environment's order."""


def load_graph(config: KnowledgeConfig) -> KnowledgeGraph:
    """Return the config's graph, shuffled where it is the placebo that asks for it."""
    graph = household() if config.graph is None else read_graph(config.graph)
    return shuffle_tails(graph, config.seed) if config.source == "shuffled" else graph


def scene_subgraphs(config: KnowledgeConfig, facets: Facets) -> dict[str, KnowledgeGraph]:
    """Return what the graph says about each slot, by the slot's name."""
    graph, slots = load_graph(config), slots_of(config, facets)
    return {
        slot.name: sub
        for slot, sub in zip(slots, slot_subgraphs(graph, slots, config)[0], strict=True)
    }


def scene_subgraph(config: KnowledgeConfig, facets: Facets) -> KnowledgeGraph:
    """Return what the graph says about all slots together."""
    graph = load_graph(config)
    subgraphs, _ = slot_subgraphs(graph, slots_of(config, facets), config)
    triples = [np.stack([s.heads, s.relations, s.tails], axis=1) for s in subgraphs]
    nodes = [s.nodes for s in subgraphs]
    empty = np.empty((0, 3), np.int32)
    return KnowledgeGraph(
        graph.names,
        graph.relation_names,
        np.concatenate([empty, *triples]),
        nodes=np.concatenate([empty[:, 0], *nodes]),
        labels=graph.labels,
    )


def scene_sentences(config: KnowledgeConfig, facets: Facets) -> dict[str, str]:
    """Return the sentence of each slot, by the slot's name."""
    return {
        name: sentence(sub, config.sentence)
        for name, sub in scene_subgraphs(config, facets).items()
    }


def slot_subgraphs(
    graph: KnowledgeGraph, slots: Sequence[Facet], config: KnowledgeConfig
) -> tuple[list[KnowledgeGraph], list[str | None]]:
    """Return each slot's subgraph and its colour's name in the graph."""
    false = config.source in ("shuffled", "wrong-object")
    described = _wrong_objects(graph, slots, config) if config.source == "wrong-object" else slots
    subgraphs: list[KnowledgeGraph] = []
    colours: list[str | None] = []
    for place, facet in enumerate(described):
        index = None
        if false and facet.colour is not None:
            index = sum(other.object == facet.object for other in described[:place])
        subgraph = facet_subgraph(graph, facet, config, index)
        subgraphs.append(subgraph)
        colours.append(_colour_of(subgraph, facet, config))
    return subgraphs, colours


def _colour_of(subgraph: KnowledgeGraph, facet: Facet, config: KnowledgeConfig) -> str | None:
    """Return the graph's name of the one colour that is left in a facet's subgraph."""
    if facet.colour is None:
        return None
    entity = subgraph.entity_id(config.entity_names.get(facet.object, facet.object))
    relation = subgraph.relation_id(config.colour_relation)
    rows = np.flatnonzero((subgraph.heads == entity) & (subgraph.relations == relation))
    return subgraph.names[subgraph.tails[rows[0]]] if len(rows) else None


def _wrong_objects(
    graph: KnowledgeGraph, slots: Sequence[Facet], config: KnowledgeConfig
) -> list[Facet]:
    """Give each object another one of the graph with as many colours, drawn by the seed."""
    true = list(dict.fromkeys(slot.object for slot in slots))
    needed = max(sum(slot.object == name for slot in slots) for name in true)
    in_task = {graph.entity_id(config.entity_names.get(name, name)) for name in true}
    relation = graph.relation_id(config.colour_relation)
    heads, colours = np.unique(graph.heads[graph.relations == relation], return_counts=True)
    heads = heads[colours >= needed]
    others = [graph.names[i] for i in heads if i not in in_task]
    if len(others) < len(true):
        raise UserError(
            f"The placebo 'wrong-object' needs {len(true)} other objects with {needed} "
            f"colours in the graph, which has {len(others)}. Take another placebo, e.g. 'shuffled'."
        )
    drawn = np.random.default_rng(config.seed).choice(len(others), len(true), replace=False)
    false = {name: others[i] for name, i in zip(true, drawn, strict=True)}
    return [replace(slot, object=false[slot.object]) for slot in slots]
