"""Scenes: the subgraph and the sentence of every slot of a task."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.config import KnowledgeConfig
from knowarm.knowledge.facets import Facet, facet_subgraph, slots_of
from knowarm.knowledge.formats import open_graph
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.sentence import sentence
from knowarm.knowledge.vectors.placebos import ShuffledGraph, WrongObject
from knowarm.knowledge.vectors.source import VectorSource

Facets = Sequence[tuple[str, str]]
"""The task's (object, colour) pairs, in the environment's order."""


def load_graph(
    config: KnowledgeConfig, run_seed: int = 0, graph: KnowledgeGraph | None = None
) -> KnowledgeGraph:
    """Read the config's graph, and change it where the source is a placebo that does so.

    Args:
        config: graph and source.
        run_seed: seed of the training run, for placebos that are drawn.
        graph: take this graph in place of the config's, such as an edited one.
    """
    graph = open_graph(config.graph) if graph is None else graph
    source = config.source
    if not isinstance(source, VectorSource):
        return graph
    return source.change_graph(graph, source.draw_seed(config.seed, run_seed))


def scene_subgraphs(config: KnowledgeConfig, facets: Facets) -> dict[str, KnowledgeGraph]:
    """Return the subgraph of each slot, by the slot's name."""
    graph, slots = load_graph(config), slots_of(config, facets)
    return {
        slot.name: sub
        for slot, sub in zip(slots, slot_subgraphs(graph, slots, config)[0], strict=True)
    }


def scene_subgraph(config: KnowledgeConfig, facets: Facets) -> KnowledgeGraph:
    """Return the union of the slots' subgraphs."""
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
    graph: KnowledgeGraph, slots: Sequence[Facet], config: KnowledgeConfig, run_seed: int = 0
) -> tuple[list[KnowledgeGraph], list[str | None]]:
    """Return each slot's subgraph and its colour's name in the graph.

    Args:
        graph: the graph, see `load_graph`.
        slots: what each slot describes.
        config: how.
        run_seed: seed of the training run, for placebos that are drawn.
    """
    source, described = config.source, slots
    if isinstance(source, WrongObject):
        described = _wrong_objects(graph, slots, config, source.draw_seed(config.seed, run_seed))
    false = isinstance(source, WrongObject | ShuffledGraph)
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
    """Return the graph's name of the one colour in a facet's subgraph."""
    if facet.colour is None:
        return None
    entity = subgraph.entity_id(config.entity_names.get(facet.object, facet.object))
    relation = subgraph.relation_id(config.colour_relation)
    rows = np.flatnonzero((subgraph.heads == entity) & (subgraph.relations == relation))
    return subgraph.names[subgraph.tails[rows[0]]] if len(rows) else None


def _wrong_objects(
    graph: KnowledgeGraph, slots: Sequence[Facet], config: KnowledgeConfig, seed: int
) -> list[Facet]:
    """Replace each object by another one of the graph with as many colours, drawn by the seed."""
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
    drawn = np.random.default_rng(seed).choice(len(others), len(true), replace=False)
    false = {name: others[i] for name, i in zip(true, drawn, strict=True)}
    return [replace(slot, object=false[slot.object]) for slot in slots]
