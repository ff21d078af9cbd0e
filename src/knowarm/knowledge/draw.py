"""Drawings of graphs as SVG files, in columns around their objects."""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, cycle
from operator import attrgetter

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.graph.denials import without_derived
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import label_of
from knowarm.svg import curve, document, element, hover, label, text_width

MAX_ENTITIES = 300
"""Largest graph that is drawn; a larger drawing cannot be read."""
ROW = 26
GAP = 22
TOP = 46
"""Heights [px]: of a row, above a group, above the drawing."""
PAD = 12
COLUMN = 190
"""Widths [px]: beside a label, between columns."""
SPOKEN = 60
"""Facts in the description for screen readers."""
COLOURS = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#b8860b",
    "#56b4e9",
    "#7f5fb0",
    "#8c564b",
)
"""One per root; the first six are Okabe and Ito's, which colour-blind readers can tell apart."""
GREY = "#8a8a8a"

_Fact = tuple[int, str, int]
"""Id of the head, label of the relation, id of the tail."""
_Neighbours = dict[int, list[tuple[str, int]]]
"""Labels of relations and ids of the entities that they lead to, by the id of an entity."""


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


_Boxes = dict[int, _Box]
"""Boxes by the id of their entity."""


def draw_svg(graph: KnowledgeGraph, roots: Sequence[str] = (), title: str = "") -> str:
    """Draw a graph of at most `MAX_ENTITIES` entities; return the text of an SVG file.

    The roots are in the first column, each other entity in the column of its distance from them.
    Within a column, entities are grouped under the relation that reaches them. Edges have the
    colour of the root they come from.
    """
    graph = without_derived(graph)
    if not len(graph.nodes):
        raise UserError(
            "The graph is empty, so there is nothing to draw. Give other objects."
        )
    if len(graph.nodes) > MAX_ENTITIES:
        raise UserError(
            f"The graph has {len(graph.nodes):,} entities; a drawing holds at most "
            f"{MAX_ENTITIES}. Select a part by objects, fewer hops or some relations."
        )
    facts = []
    for head, relation, tail in graph.triples.tolist():
        words = label_of(graph.relation_names[relation], graph.labels)
        facts.append((head, words, tail))
    beside = _neighbours(facts)
    boxes = _columns(graph, beside, list(map(graph.entity_id, roots)))
    markup = [
        label(16, 26, title, font_size=16, font_weight="bold", fill="#222"),
        *_headings(boxes, beside),  # places the boxes
        *(_edge(boxes[head], words, boxes[tail]) for head, words, tail in facts),
    ]
    for _, box in sorted(boxes.items()):
        fill = "#f1f1f1"
        line = "#c8c8c8"
        ink = "#222"
        if box.column == 0:
            fill = line = box.colour
            ink = "#fff"
        markup.append(
            element(
                "rect",
                x=box.x,
                y=box.y,
                width=box.width,
                height=ROW - 4,
                rx=6,
                fill=fill,
                stroke=line,
            )
        )
        middle = box.x + box.width / 2
        markup.append(
            label(middle, box.y + 15.5, box.label, text_anchor="middle", fill=ink)
        )
    spoken = []
    for head, words, tail in facts[:SPOKEN]:
        spoken.append(f"{boxes[head].label} {words} {boxes[tail].label}")
    description = f"{len(graph)} facts: {'; '.join(spoken)}"
    if len(facts) > SPOKEN:
        description += f"; and {len(facts) - SPOKEN} more"
    return document(
        round(max(box.x + box.width for box in boxes.values()) + 24),
        round(max(box.y for box in boxes.values()) + ROW + 16),
        title or "Knowledge graph",
        *markup,
        description=description,
    )


def _neighbours(facts: Sequence[_Fact]) -> _Neighbours:
    """Return what each entity is linked to, in either direction, and by which relation."""
    beside: _Neighbours = defaultdict(list)
    for head, words, tail in facts:
        beside[head].append((words, tail))
        beside[tail].append((f"{words} (of)", head))
    return beside


def _columns(graph: KnowledgeGraph, beside: _Neighbours, roots: list[int]) -> _Boxes:
    """Return every entity's box: its distance from the roots, and the relation that reaches it."""
    if not roots:
        roots = np.setdiff1d(graph.nodes, graph.tails).tolist()
    if not roots:
        roots = np.unique(graph.heads).tolist()
    boxes = _Boxes()

    def add(entity: int, column: int, group: str, colour: str) -> None:
        if entity not in boxes:
            text = label_of(graph.names[entity], graph.labels)
            boxes[entity] = _Box(text, column, group, colour)
            reached.append(entity)

    colours = dict(zip(dict.fromkeys(roots), cycle(COLOURS), strict=False))
    unreached = ({node: GREY} for node in graph.nodes.tolist())
    for starts in chain([colours], unreached):  # last the components without a root
        reached = list[int]()
        for root, colour in starts.items():
            add(root, 0, "", colour)
        column = 0
        while reached:
            column += 1
            frontier = sorted(reached) if column > 1 else reached
            reached = []
            for entity in frontier:
                for words, other in beside[entity]:
                    add(other, column, words, boxes[entity].colour)
    return boxes


def _headings(boxes: _Boxes, beside: _Neighbours) -> list[str]:
    """Set the position of every box; return the headings of the groups."""
    columns: dict[int, list[int]] = defaultdict(list)
    for entity, box in boxes.items():
        columns[box.column].append(entity)

    def order(entity: int) -> tuple[str, float, str]:
        """Return group, mean height of the neighbours in earlier columns, and label."""
        box = boxes[entity]
        neighbours = [boxes[other] for _, other in beside[entity]]
        heights = [other.y for other in neighbours if other.column < box.column]
        return box.group, math.fsum(heights) / max(len(heights), 1), box.label

    headings = []
    x = 24.0
    tallest = 0.0
    for _, entities in sorted(columns.items()):
        y = float(TOP)
        group = ""
        for entity in sorted(entities, key=order):
            box = boxes[entity]
            if box.group != group:
                group = box.group
                y += GAP
                headings.append(
                    label(x, y - 5, group, fill="#666", font_style="italic")
                )
            box.x = x
            box.y = y
            y += ROW
        tallest = max(tallest, y)
        x += max(boxes[entity].width for entity in entities) + COLUMN
    roots = sorted((boxes[entity] for entity in columns[0]), key=lambda box: box.y)
    step = (tallest - TOP) / len(roots)
    if step > ROW:  # spread the roots over the height of their neighbours
        for number, box in enumerate(roots):
            box.y = TOP + step * (number + 0.5) - ROW / 2
    return headings


def _edge(head: _Box, words: str, tail: _Box) -> str:
    """Return the curve of an edge, with the fact as its tooltip."""
    left, right = sorted((head, tail), key=attrgetter("column"))
    end_x = right.x
    bend = None
    if left.column == right.column:
        end_x += right.width
        bend = 40
    return curve(
        (left.x + left.width, left.y + ROW / 2 - 2),
        (end_x, right.y + ROW / 2 - 2),
        hover(f"{head.label} {words} {tail.label}"),
        bend=bend,
        fill="none",
        stroke=head.colour,
        stroke_width=1.4,
        stroke_opacity=0.75,
    )
