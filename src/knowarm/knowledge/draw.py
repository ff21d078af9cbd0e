"""Drawings of graphs as SVG files, in columns around their objects."""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

from knowarm.errors import UserError
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import label_of
from knowarm.svg import curve, document, element, hover, label, text_width

MAX_ENTITIES = 300
"""Largest graph that is drawn; a larger drawing cannot be read."""
ROW, GAP, TOP = 26, 22, 46
PAD, COLUMN = 12, 190
"""Sizes [px]: of a row, above a group, above the drawing; beside a label, between columns."""
SPOKEN = 60
"""Facts in the description for screen readers."""
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b8860b", "#56b4e9", "#7f5fb0", "#8c564b")
"""One per root; the first six are Okabe and Ito's, which colour-blind readers can tell apart."""
GREY = "#8a8a8a"


@dataclass
class _Box:
    """An entity's label and its place [px]."""

    label: str
    column: int
    group: str
    colour: str
    """The colour of its root."""
    x: float = 0.0
    y: float = 0.0

    @property
    def width(self) -> float:
        return text_width(self.label) + 2 * PAD


def draw_svg(graph: KnowledgeGraph, roots: Sequence[str] = (), title: str = "") -> str:
    """Draw a graph of at most `MAX_ENTITIES` entities; return the text of an SVG file.

    The roots are in the first column, each other entity in the column of its distance from them.
    Within a column, entities are grouped under the relation that reaches them. Edges have the
    colour of the root they come from.
    """
    if not len(graph.nodes):
        raise UserError("The graph is empty, so there is nothing to draw. Give other objects.")
    if len(graph.nodes) > MAX_ENTITIES:
        raise UserError(
            f"The graph has {len(graph.nodes):,} entities; a drawing holds at most "
            f"{MAX_ENTITIES}. Select a part by objects, fewer hops or some relations."
        )
    boxes = _columns(graph, [graph.entity_id(name) for name in dict.fromkeys(roots)])
    parts = [
        label(16, 26, title, font_size=16, font_weight="bold", fill="#222"),
        *_headings(graph, boxes),  # places the boxes
        *_edges(graph, boxes),
    ]
    for _, box in sorted(boxes.items()):
        root = box.column == 0
        fill, line, ink = (
            (box.colour, box.colour, "#fff") if root else ("#f1f1f1", "#c8c8c8", "#222")
        )
        size = {"x": box.x, "y": box.y, "width": box.width, "height": ROW - 4, "rx": 6}
        middle = box.x + box.width / 2
        parts.append(element("rect", **size, fill=fill, stroke=line))
        parts.append(label(middle, box.y + 15.5, box.label, text_anchor="middle", fill=ink))
    facts = ["{} {} {}".format(*(label_of(n, graph.labels) for n in triple)) for triple in graph]
    more = f"; and {len(facts) - SPOKEN} more" if len(facts) > SPOKEN else ""
    return document(
        round(max(box.x + box.width for box in boxes.values()) + 24),
        round(max(box.y for box in boxes.values()) + ROW + 16),
        title or "Knowledge graph",
        *parts,
        description=f"{len(graph)} facts: {'; '.join(facts[:SPOKEN])}{more}",
    )


def _columns(graph: KnowledgeGraph, roots: list[int]) -> dict[int, _Box]:
    """Return every entity's box: its distance from the roots, and the relation that reaches it."""
    beside: dict[int, list[tuple[str, int]]] = defaultdict(list)
    for h, r, t in zip(graph.heads, graph.relations, graph.tails, strict=True):
        words = label_of(graph.relation_names[int(r)], graph.labels)
        beside[int(h)].append((words, int(t)))
        beside[int(t)].append((f"{words} (of)", int(h)))
    nodes: list[int] = graph.nodes.tolist()
    if not roots:
        reached = set(graph.tails.tolist())
        roots = [i for i in nodes if i not in reached] or sorted(set(graph.heads.tolist()))
    boxes: dict[int, _Box] = {}

    def add(entity: int, column: int, group: str, colour: str) -> int:
        boxes[entity] = _Box(label_of(graph.names[entity], graph.labels), column, group, colour)
        return entity

    for start in (roots, *([i] for i in nodes)):  # then the components without a root
        shades = COLOURS if start is roots else (GREY,)
        new = [i for i in start if i not in boxes]
        frontier = [add(i, 0, "", shades[place % len(shades)]) for place, i in enumerate(new)]
        column = 0
        while frontier:
            column += 1
            frontier = sorted(
                add(other, column, words, boxes[entity].colour)
                for entity in frontier
                for words, other in beside[entity]
                if other not in boxes
            )
    return boxes


def _headings(graph: KnowledgeGraph, boxes: dict[int, _Box]) -> list[str]:
    """Set the place of every box; return the headings of the groups."""
    headings = []
    x = 24.0
    tallest = 0.0
    columns = range(1 + max(box.column for box in boxes.values()))
    for column in columns:
        inside = sorted(
            (i for i, box in boxes.items() if box.column == column),
            key=lambda i: (boxes[i].group, _barycentre(graph, boxes, i), boxes[i].label),
        )
        y, group = float(TOP), ""
        for box in (boxes[i] for i in inside):
            if box.group != group:
                y, group = y + GAP, box.group
                headings.append(label(x, y - 5, group, fill="#666", font_style="italic"))
            box.x, box.y = x, y
            y += ROW
        tallest = max(tallest, y)
        x += max(boxes[i].width for i in inside) + COLUMN
    roots = sorted((box for box in boxes.values() if box.column == 0), key=lambda box: box.y)
    step = (tallest - TOP) / len(roots)
    if step > ROW:  # spread the roots over the height of their neighbours
        for place, box in enumerate(roots):
            box.y = TOP + step * (place + 0.5) - ROW / 2
    return headings


def _barycentre(graph: KnowledgeGraph, boxes: dict[int, _Box], entity: int) -> float:
    """Return the mean height of the neighbours in earlier columns."""
    beside = [*graph.tails[graph.out_rows(entity)], *graph.heads[graph.in_rows(entity)]]
    placed = [boxes[int(i)].y for i in beside if boxes[int(i)].column < boxes[entity].column]
    return math.fsum(placed) / len(placed) if placed else 0.0


def _edges(graph: KnowledgeGraph, boxes: dict[int, _Box]) -> list[str]:
    """Return one curve per edge, with the fact as its tooltip."""
    parts = []
    for h, r, t in zip(graph.heads, graph.relations, graph.tails, strict=True):
        head, tail = boxes[int(h)], boxes[int(t)]
        left, right = (head, tail) if head.column <= tail.column else (tail, head)
        same = left.column == right.column
        start = (left.x + left.width, left.y + ROW / 2 - 2)
        end = (right.x + right.width * same, right.y + ROW / 2 - 2)
        words = label_of(graph.relation_names[int(r)], graph.labels)
        tooltip = hover(f"{head.label} {words} {tail.label}")
        line = {"fill": "none", "stroke": head.colour, "stroke_width": 1.4, "stroke_opacity": 0.75}
        parts.append(curve(start, end, tooltip, bend=40 if same else None, **line))
    return parts
