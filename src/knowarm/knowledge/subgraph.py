"""Gamma: selection of the subgraph around the perceived objects (paper section 4.1)."""

from collections.abc import Iterable, Sequence
from typing import Literal, get_args

import numpy as np

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.graph import KnowledgeGraph

Direction = Literal["out", "in", "both"]


def gamma(
    graph: KnowledgeGraph,
    entities: Sequence[str],
    *,
    hops: int = 1,
    direction: Direction = "out",
    relations: Iterable[str] | None = None,
    max_degree: int | None = None,
) -> KnowledgeGraph:
    """Select the perceived objects and all entities at most `hops` edges from them.

    Gamma(G, O) of the paper (section 4.1): "all the nodes representing the objects that the agent
    is perceiving and the nodes at distance 1 from them", and the edges between the two.

    Further hops keep their direction: an entity reached along an edge's direction is left along
    it only. So `mug -> red` may continue to `red -> color` and never returns through
    `red <- fire_truck`: an attribute that many objects share stays a leaf.

    Args:
        graph: the whole graph.
        entities: names of the perceived objects (or last parts of IRIs, or labels).
        hops: largest distance in edges, at least 0.
        direction: edges to follow: "out" (the object is the head), "in", or "both".
        relations: names of the relations to follow; None follows all.
        max_degree: an entity with more edges than this in the direction of search is not
            expanded; None sets no limit.

    Returns:
        A graph that shares its names with `graph` and contains every given entity.

    Raises:
        UserError: an entity or relation is not in the graph, or `hops` < 0.
    """
    if hops < 0:
        raise UserError(f"hops is {hops}; it must be 0 or more (the paper's value is 1).")
    if direction not in get_args(Direction):
        raise unknown_name("direction", direction, get_args(Direction))
    start = np.array(sorted({graph.entity_id(name) for name in entities}), np.int32)
    allowed = None if relations is None else np.array([graph.relation_id(r) for r in relations])
    ways = ("out", "in") if direction == "both" else (direction,)
    found = [
        rows
        for way in ways
        for rows in _reach(graph, start, hops, way == "out", allowed, max_degree)
    ]
    if not found:
        rows = np.empty(0, np.int64)
    elif len(found) == 1:
        rows = found[0] if ways == ("out",) else np.sort(found[0])
    else:
        rows = np.unique(np.concatenate(found))
    return graph.rows(rows, nodes=start)


def _reach(
    graph: KnowledgeGraph,
    start: np.ndarray,
    hops: int,
    outward: bool,
    allowed: np.ndarray | None,
    max_degree: int | None,
) -> list[np.ndarray]:
    """Return the rows of edges within `hops` of the start ids, all in one direction."""
    found: list[np.ndarray] = []
    seen = frontier = start
    for hop in range(hops):
        fresh = []
        for entity in frontier:
            if outward:
                span = graph.out_rows(entity)
                rows = np.arange(span.start, span.stop)
            else:
                rows = graph.in_rows(entity)
            if hop and max_degree is not None and len(rows) > max_degree:
                continue
            if allowed is not None:
                rows = rows[np.isin(graph.relations[rows], allowed)]
            fresh.append(rows)
        found += fresh
        if hop + 1 < hops and fresh:
            reached = (graph.tails if outward else graph.heads)[np.concatenate(fresh)]
            frontier = np.setdiff1d(reached, seen)
            seen = np.union1d(seen, frontier)
        elif not fresh:
            break
    return found
