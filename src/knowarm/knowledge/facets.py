"""Facets: (object, colour) pairs of the task, the slots they fill, and their subgraphs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.builder import graph_of, union
from knowarm.knowledge.config import KnowledgeConfig
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.subgraph import gamma
from knowarm.knowledge.terms import label_of, local_name


@dataclass(frozen=True)
class Facet:
    """What one slot of the scene embedding describes."""

    object: str
    """The object, by its name in the task."""
    colour: str | None
    """The colour, by its name in the task; None describes the object without its colours."""

    @property
    def name(self) -> str:
        """The slot's name in tables: "red mug", "mug"."""
        words = self.object if self.colour is None else f"{self.colour} {self.object}"
        return label_of(words, {})


def slots_of(config: KnowledgeConfig, facets: Sequence[tuple[str, str]]) -> tuple[Facet, ...]:
    """Return the slots in the order of the facets: one per object (partial) or facet (full)."""
    if config.detail == "none":
        return ()
    if config.detail == "partial":
        return tuple(Facet(name, None) for name in dict.fromkeys(pair[0] for pair in facets))
    return tuple(Facet(*pair) for pair in dict.fromkeys(map(tuple, facets)))


def graph_facets(
    objects: Sequence[str], graph: KnowledgeGraph, colour_relation: str = "hasColor"
) -> list[tuple[str, str]]:
    """Return (object, colour) pairs with the colours that the graph gives each object, by name.

    An object without a colour gets the pair (object, ""), which only detail "partial" accepts.
    """
    exact = graph.relation_names.find(colour_relation)
    wanted = graph.relation_names.find_local(colour_relation) if exact is None else [exact]
    pairs = []
    for name in objects:
        rows = graph.out_rows(graph.entity_id(name))
        tails = graph.tails[rows][np.isin(graph.relations[rows], wanted)]
        colours = [local_name(graph.names[i]) for i in np.sort(tails)]
        pairs += [(name, colour) for colour in colours or [""]]
    return pairs


def with_seen_colours(
    graph: KnowledgeGraph, slots: Sequence[Facet], config: KnowledgeConfig
) -> KnowledgeGraph:
    """Add the colours in which objects are seen, for objects of which the graph states none.

    Raises:
        UserError: the graph lacks an object.
    """
    stated = {
        graph.names[head]
        for head, relation in zip(graph.heads, graph.relations, strict=True)
        if local_name(graph.relation_names[relation]) == config.colour_relation
    }
    seen = []
    for slot in slots:
        name = graph.names[graph.entity_id(config.entity_names.get(slot.object, slot.object))]
        if slot.colour is not None and name not in stated:
            colour = config.entity_names.get(slot.colour, slot.colour)
            seen.append((name, config.colour_relation, colour))
    return union(graph, graph_of(seen)) if seen else graph


def facet_subgraph(
    graph: KnowledgeGraph, facet: Facet, config: KnowledgeConfig, colour_index: int | None = None
) -> KnowledgeGraph:
    """Select the subgraph of a facet: Gamma of the object, with the facet's colour only.

    Args:
        graph: the whole graph.
        facet: the object and its colour, or None for no colour fact.
        config: hops, direction, relations and the name of the colour relation.
        colour_index: take the object's colour of this number in place of the facet's own: for a
            falsified graph, which does not hold the true colour.

    Raises:
        UserError: the graph lacks the object, the colour relation, or that colour of the object.
    """
    names = config.entity_names
    name = names.get(facet.object, facet.object)
    around = gamma(
        graph,
        [name],
        hops=config.hops,
        direction=config.direction,
        relations=config.relations,
        max_degree=config.max_degree,
    )
    entity = graph.entity_id(name)
    relation = _colour_relation(graph, config.colour_relation, required=facet.colour is not None)
    colours = (around.heads == entity) & (around.relations == relation)
    keep = ~colours
    if facet.colour is not None:
        keep[_colour_row(around, np.flatnonzero(colours), facet, names, colour_index)] = True
    return around.rows(np.flatnonzero(keep), nodes=np.array([entity]))


def _colour_relation(graph: KnowledgeGraph, name: str, *, required: bool) -> int:
    """Return the relation's id; -1 if the graph has none and none is required."""
    try:
        return graph.relation_id(name)
    except UserError as error:
        if not required:
            return -1
        known = [local_name(n) for n in graph.relation_names]
        hint = " Set colour_relation to the graph's relation, or detail to 'partial'."
        raise UserError(str(unknown_name("colour relation", name, known)) + hint) from error


def _colour_row(
    around: KnowledgeGraph,
    rows: np.ndarray,
    facet: Facet,
    names: Mapping[str, str],
    colour_index: int | None,
) -> int:
    """Return the row of the facet's colour fact among the object's colour facts."""
    if colour_index is not None and len(rows):
        return int(rows[colour_index % len(rows)])
    wanted = names.get(facet.colour or "", facet.colour or "")
    for row in rows:
        tail = around.names[around.tails[row]]
        label = label_of(tail, around.labels)
        if wanted in (tail, local_name(tail)) or label_of(wanted, {}) == label:
            return int(row)
    if not wanted:
        raise UserError(
            f"{facet.object!r} has no colour in the graph, so detail 'full' cannot describe it. "
            f"Add its colours to the graph, or set detail to 'partial'."
        )
    known = sorted(local_name(around.names[around.tails[row]]) for row in rows)
    raise UserError(
        f"The graph does not say that {facet.object!r} can be {wanted!r}. "
        f"Its colours there: {', '.join(known) or 'none'}. "
        f"Add that fact to the graph, or set detail to 'partial'."
    )
