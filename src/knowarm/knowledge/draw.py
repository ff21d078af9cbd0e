"""Drawings as SVG files: graphs in columns around their objects, and tables of cosines."""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.terms import label_of
from knowarm.svg import curve, document, element, hover, label, text_width

MAX_ENTITIES = 300
"""Largest graph that is drawn; a larger drawing cannot be read."""

TALL = 16
"""A column of at least as many neighbours is split over both sides of the roots."""

ROW, GAP, TOP = 26, 22, 46
PAD, COLUMN = 12, 190
"""Sizes [px]: of a row, above a group, above the drawing; beside a label, between columns."""

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b8860b", "#56b4e9", "#7f5fb0", "#8c564b")
"""One per root; the first six are Okabe and Ito's, which colour-blind readers can tell apart."""

GREY = "#8a8a8a"
CELL = 46
BLUE, RED = (33, 102, 172), (178, 24, 43)
"""Colours of the cosines -1 and 1."""


@dataclass
class _Box:
    """An entity's label and its place [px]."""

    label: str
    column: int
    group: str = ""
    x: float = 0.0
    y: float = 0.0

    @property
    def width(self) -> float:
        return text_width(self.label) + 2 * PAD


def draw_svg(graph: KnowledgeGraph, roots: Sequence[str] = (), title: str = "") -> str:
    """Draw a graph as an SVG file.

    The roots are in the first column, each other entity in the column of its distance from them.
    Within a column, entities are grouped under the relation that reaches them. Edges have the
    colour of the root they come from.

    Args:
        graph: the graph, at most `MAX_ENTITIES` entities.
        roots: entities of the first column; none takes all entities without an incoming edge.
        title: heading of the drawing.

    Returns:
        The text of the file.

    Raises:
        UserError: the graph is empty or too large, or a root is not in it.
    """
    if not len(graph.nodes):
        raise UserError("The graph is empty, so there is nothing to draw. Give other objects.")
    if len(graph.nodes) > MAX_ENTITIES:
        raise UserError(
            f"The graph has {len(graph.nodes):,} entities; a drawing holds at most "
            f"{MAX_ENTITIES}. Select a part by objects, fewer hops or some relations."
        )
    first = [graph.entity_id(name) for name in dict.fromkeys(roots)] or _sources(graph)
    boxes, colours = _columns(graph, first)
    _use_both_sides(boxes)
    headings = _place(graph, boxes)
    parts = [
        label(16, 26, title, font_size=16, font_weight="bold", fill="#222"),
        *_edges(graph, boxes, colours),
        *(label(x, y, text, fill="#666", font_style="italic") for x, y, text in headings),
    ]
    for entity, box in sorted(boxes.items()):
        parts += _box(box, colours.get(entity, GREY) if box.column == 0 else None)
    return document(
        round(max(box.x + box.width for box in boxes.values()) + 24),
        round(max(box.y for box in boxes.values()) + ROW + 16),
        title or "Knowledge graph",
        *parts,
        description=f"{len(graph)} facts: {_description(graph)}",
    )


def heatmap_svg(values: np.ndarray, rows: Sequence[str], title: str, note: str = "") -> str:
    """Draw a square table such as cosines: white is 0, red 1, blue -1, with every number written.

    Args:
        values: (n, n) float; NaN is left blank.
        rows: names of rows and columns, n.
        title: heading.
        note: line below the heading.

    Returns:
        The text of an SVG file.
    """
    top, left = 60, 20 + max(map(text_width, rows))
    parts = [
        label(10, 22, title, font_size=15, font_weight="bold", fill="#222"),
        label(10, 42, note, fill="#555"),
    ]
    ink = {"fill": "#222"}
    for i, name in enumerate(rows):
        middle = CELL * (i + 0.5)
        row_name = f"{i + 1}. {name}"
        parts.append(label(left - 8, top + middle + 4, row_name, text_anchor="end", **ink))
        bottom = top + CELL * len(rows) + 18
        parts.append(label(left + middle, bottom, str(i + 1), text_anchor="middle", **ink))
        for j, value in enumerate(values[i].tolist()):
            parts += _cell(left + CELL * j, top + CELL * i, value)
    width = max(left + CELL * len(rows), text_width(title, 15), text_width(note)) + 20
    return document(round(width), top + CELL * len(rows) + 34, title, *parts)


def _sources(graph: KnowledgeGraph) -> list[int]:
    """Return the entities without an incoming edge; all heads if there is none."""
    reached = set(graph.tails.tolist())
    sources = [int(i) for i in graph.nodes if int(i) not in reached]
    return sources or sorted(set(graph.heads.tolist())) or graph.nodes.tolist()


def _columns(graph: KnowledgeGraph, first: list[int]) -> tuple[dict[int, _Box], dict[int, str]]:
    """Return every entity's box, with column and group, and the colour of its root."""
    beside: dict[int, list[tuple[str, int]]] = defaultdict(list)
    for h, r, t in zip(graph.heads, graph.relations, graph.tails, strict=True):
        words = label_of(graph.relation_names[int(r)], graph.labels)
        beside[int(h)].append((words, int(t)))
        beside[int(t)].append((f"{words} (of)", int(h)))
    colours = {root: COLOURS[i % len(COLOURS)] for i, root in enumerate(first)}
    boxes = {i: _Box(label_of(graph.names[i], graph.labels), 0) for i in first}
    frontier, column = list(first), 0
    while frontier or len(boxes) < len(graph.nodes):
        column += 1
        if not frontier:  # a component without a root
            rest = [int(i) for i in graph.nodes if int(i) not in boxes]
            boxes |= {i: _Box(label_of(graph.names[i], graph.labels), 0) for i in rest[:1]}
            frontier, column = rest[:1], 0
            continue
        reached: dict[int, str] = {}
        for entity in frontier:
            for words, other in beside[entity]:
                if other not in boxes and other not in reached:
                    reached[other] = words
                    colours[other] = colours.get(entity, GREY)
        for other, words in reached.items():
            boxes[other] = _Box(label_of(graph.names[other], graph.labels), column, words)
        frontier = sorted(reached)
    return boxes, colours


def _use_both_sides(boxes: dict[int, _Box]) -> None:
    """Move half of a long single column of neighbours to the other side of the roots."""
    ring = [box for box in boxes.values() if box.column == 1]
    if len(ring) < TALL or any(box.column > 1 for box in boxes.values()):
        return
    groups = sorted({box.group for box in ring})
    left = 0
    for group in groups:
        inside = [box for box in ring if box.group == group]
        if 2 * left + len(inside) > len(ring):
            break
        for box in inside:
            box.column = -1
        left += len(inside)


def _place(graph: KnowledgeGraph, boxes: dict[int, _Box]) -> list[tuple[float, float, str]]:
    """Set the place of every box; return the headings of the groups: x, y, text."""
    headings: list[tuple[float, float, str]] = []
    x = 24.0
    tallest = 0.0
    columns = {box.column for box in boxes.values()}
    for column in range(min(columns), max(columns) + 1):
        inside = sorted(
            (i for i, box in boxes.items() if box.column == column),
            key=lambda i: (boxes[i].group, _barycentre(graph, boxes, i), boxes[i].label),
        )
        y, group = float(TOP), ""
        for i in inside:
            box = boxes[i]
            if box.group != group:
                y += GAP
                headings.append((x, y - 5, box.group))
                group = box.group
            box.x, box.y = x, y
            y += ROW
        tallest = max(tallest, y)
        widest = max(boxes[i].width for i in inside)
        for i in inside:
            if column < 0:  # flush right, towards the roots
                boxes[i].x = x + widest - boxes[i].width
        x += widest + COLUMN
    roots = [i for i, box in boxes.items() if box.column == 0]
    step = (tallest - TOP) / len(roots)
    if step > ROW:  # spread the roots over the height of their neighbours
        for place, i in enumerate(sorted(roots, key=lambda i: boxes[i].y)):
            boxes[i].y = TOP + step * (place + 0.5) - ROW / 2
    return headings


def _barycentre(graph: KnowledgeGraph, boxes: dict[int, _Box], entity: int) -> float:
    """Return the mean height of the neighbours in earlier columns."""
    beside = [*graph.tails[graph.out_rows(entity)], *graph.heads[graph.in_rows(entity)]]
    placed = [boxes[int(i)].y for i in beside if boxes[int(i)].column < boxes[entity].column]
    return math.fsum(placed) / len(placed) if placed else 0.0


def _edges(
    graph: KnowledgeGraph, boxes: Mapping[int, _Box], colours: Mapping[int, str]
) -> list[str]:
    """Return one curve per edge, with the fact as its tooltip."""
    parts = []
    for h, r, t in zip(graph.heads, graph.relations, graph.tails, strict=True):
        head, tail = boxes[int(h)], boxes[int(t)]
        left, right = (head, tail) if head.column <= tail.column else (tail, head)
        start = (left.x + left.width, left.y + ROW / 2 - 2)
        end = (right.x + right.width * (left.column == right.column), right.y + ROW / 2 - 2)
        words = label_of(graph.relation_names[int(r)], graph.labels)
        parts.append(
            curve(
                start,
                end,
                hover(f"{head.label} {words} {tail.label}"),
                bend=40 if left.column == right.column else None,
                fill="none",
                stroke=colours.get(int(h), GREY),
                stroke_width=1.4,
                stroke_opacity=0.75,
            )
        )
    return parts


def _box(box: _Box, colour: str | None) -> list[str]:
    fill, ink = ("#f1f1f1", "#222") if colour is None else (colour, "#fff")
    size = {"x": box.x, "y": box.y, "width": box.width, "height": ROW - 4, "rx": 6}
    middle = box.x + box.width / 2
    return [
        element("rect", **size, fill=fill, stroke=colour or "#c8c8c8"),
        label(middle, box.y + 15.5, box.label, text_anchor="middle", fill=ink),
    ]


def _cell(x: float, y: float, value: float) -> list[str]:
    if np.isnan(value):
        return []
    strength = min(abs(value), 1.0)
    target = RED if value > 0 else BLUE
    colour = ",".join(str(round(255 + (part - 255) * strength)) for part in target)
    ink = "#ffffff" if strength > 0.6 else "#222222"
    middle = (x + CELL / 2, y + CELL / 2 + 4)
    return [
        element("rect", x=x, y=y, width=CELL, height=CELL, fill=f"rgb({colour})", stroke="#fff"),
        label(*middle, f"{value:.2f}", text_anchor="middle", fill=ink),
    ]


def _description(graph: KnowledgeGraph, most: int = 60) -> str:
    """Return the facts as text for screen readers."""
    labels = graph.labels
    facts = ["{} {} {}".format(*(label_of(n, labels) for n in triple)) for triple in graph]
    more = f"; and {len(facts) - most} more" if len(facts) > most else ""
    return "; ".join(facts[:most]) + more
