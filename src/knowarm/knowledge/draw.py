"""A graph goes in; an SVG drawing in columns, from the objects to what they lead to, comes out."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from knowarm.errors import UserError
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.labels import label_of

TALL = 16
"""A column of as many neighbours is split over both sides."""

MOST_ENTITIES = 300
"""More than this nobody can read."""

ROW, GAP, TOP = 26, 22, 46
LETTER, PAD, COLUMN = 7.4, 12, 190
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b8860b", "#56b4e9", "#7f5fb0", "#8c564b")
"""One a root; the first six are Okabe and Ito's, which colour-blind readers can tell apart."""
GREY = "#8a8a8a"


@dataclass
class _Box:
    """Where one entity stands."""

    label: str
    column: int
    group: str
    x: float = 0.0
    y: float = 0.0

    @property
    def width(self) -> float:
        return len(self.label) * LETTER + 2 * PAD


def draw_svg(graph: KnowledgeGraph, roots: Sequence[str] = (), title: str = "") -> str:
    """Draw a graph.

    The roots stand in the first column, each other entity in the column of its distance from them;
    within a column, entities are grouped under the relation that reaches them. Edges carry the
    colour of the root they come from.

    Args:
        graph: what to draw, at most MOST_ENTITIES entities.
        roots: entities of the first column; none takes all that no edge points to.
        title: heading of the drawing.

    Returns:
        The text of an SVG file.

    Raises:
        UserError: the graph is empty or too large, or a root is not in it.
    """
    if not len(graph.nodes):
        raise UserError("The graph is empty, so there is nothing to draw. Name other objects.")
    if len(graph.nodes) > MOST_ENTITIES:
        raise UserError(
            f"The graph has {len(graph.nodes):,} entities; a drawing holds at most "
            f"{MOST_ENTITIES}. Name --objects, fewer --hops or some --relations."
        )
    first = [graph.entity_id(name) for name in dict.fromkeys(roots)] or _sources(graph)
    boxes, colours = _columns(graph, first)
    _use_both_sides(boxes)
    headings = _place(graph, boxes)
    right = max(box.x + box.width for box in boxes.values()) + 24
    bottom = max(box.y for box in boxes.values()) + ROW + 16
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{right:.0f}" height="{bottom:.0f}" '
        f'viewBox="0 0 {right:.0f} {bottom:.0f}" role="img" font-size="13" '
        f'font-family="Helvetica, Arial, sans-serif">',
        f"<title>{escape(title or 'Knowledge graph')}</title>",
        f"<desc>{len(graph)} facts: {escape(_description(graph))}</desc>",
        '<rect width="100%" height="100%" fill="#ffffff"/>',
        f'<text x="16" y="26" font-size="16" font-weight="bold" fill="#222">{escape(title)}</text>',
    ]
    parts += _edges(graph, boxes, colours)
    parts += [
        f'<text x="{x:.1f}" y="{y:.1f}" fill="#666" font-style="italic">{escape(text)}</text>'
        for x, y, text in headings
    ]
    for entity, box in sorted(boxes.items()):
        parts += _box(box, colours.get(entity, GREY) if box.column == 0 else None)
    return "\n".join([*parts, "</svg>"]) + "\n"


def _sources(graph: KnowledgeGraph) -> list[int]:
    """Return the entities that no edge points to; all heads where there is none."""
    reached = set(graph.tails.tolist())
    sources = [int(i) for i in graph.nodes if int(i) not in reached]
    return sources or sorted(set(graph.heads.tolist())) or graph.nodes.tolist()


def _columns(graph: KnowledgeGraph, first: list[int]) -> tuple[dict[int, _Box], dict[int, str]]:
    """Give every entity its column and group, and every entity the colour of its root."""
    beside: dict[int, list[tuple[str, int]]] = defaultdict(list)
    for h, r, t in zip(graph.heads, graph.relations, graph.tails, strict=True):
        said = label_of(graph.relation_names[int(r)], graph.labels)
        beside[int(h)].append((said, int(t)))
        beside[int(t)].append((f"{said} (of)", int(h)))
    colours = {root: COLOURS[i % len(COLOURS)] for i, root in enumerate(first)}
    boxes = {i: _Box(label_of(graph.names[i], graph.labels), 0, "") for i in first}
    frontier, column = list(first), 0
    while frontier or len(boxes) < len(graph.nodes):
        column += 1
        if not frontier:  # a part that no edge joins to the roots
            rest = [int(i) for i in graph.nodes if int(i) not in boxes]
            boxes |= {i: _Box(label_of(graph.names[i], graph.labels), 0, "") for i in rest[:1]}
            frontier, column = rest[:1], 0
            continue
        reached: dict[int, str] = {}
        for entity in frontier:
            for said, other in beside[entity]:
                if other not in boxes and other not in reached:
                    reached[other] = said
                    colours[other] = colours.get(entity, GREY)
        for other, said in reached.items():
            boxes[other] = _Box(label_of(graph.names[other], graph.labels), column, said)
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
    """Set every box's place; return the headings of the groups: x, y, text."""
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
    return sum(placed) / len(placed) if placed else 0.0


def _edges(graph: KnowledgeGraph, boxes: dict[int, _Box], colours: dict[int, str]) -> list[str]:
    """Return one curve an edge, with the fact as its tooltip."""
    parts = []
    for h, r, t in zip(graph.heads, graph.relations, graph.tails, strict=True):
        head, tail = boxes[int(h)], boxes[int(t)]
        left, right = (head, tail) if head.column <= tail.column else (tail, head)
        x1, y1 = left.x + left.width, left.y + ROW / 2 - 2
        x2, y2 = right.x, right.y + ROW / 2 - 2
        if left.column == right.column:
            x2 = right.x + right.width
            bend = x1 + 40
            path = f"M{x1:.1f} {y1:.1f} C{bend:.1f} {y1:.1f} {bend:.1f} {y2:.1f} {x2:.1f} {y2:.1f}"
        else:
            middle = (x1 + x2) / 2
            path = (
                f"M{x1:.1f} {y1:.1f} C{middle:.1f} {y1:.1f} {middle:.1f} {y2:.1f} {x2:.1f} {y2:.1f}"
            )
        said = label_of(graph.relation_names[int(r)], graph.labels)
        colour = colours.get(int(h), GREY)
        parts.append(
            f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="1.4" '
            f'stroke-opacity="0.75"><title>{escape(f"{head.label} {said} {tail.label}")}</title>'
            f"</path>"
        )
    return parts


def _box(box: _Box, colour: str | None) -> list[str]:
    fill, text = ("#f1f1f1", "#222") if colour is None else (colour, "#fff")
    return [
        f'<rect x="{box.x:.1f}" y="{box.y:.1f}" width="{box.width:.1f}" height="{ROW - 4}" '
        f'rx="6" fill="{fill}" stroke="{colour or "#c8c8c8"}"/>',
        f'<text x="{box.x + box.width / 2:.1f}" y="{box.y + 15.5:.1f}" text-anchor="middle" '
        f'fill="{text}">{escape(box.label)}</text>',
    ]


def _description(graph: KnowledgeGraph, most: int = 60) -> str:
    """Say the facts, for readers who do not see the drawing."""
    labels = graph.labels
    facts = ["{} {} {}".format(*(label_of(n, labels) for n in triple)) for triple in graph]
    more = f"; and {len(facts) - most} more" if len(facts) > most else ""
    return "; ".join(facts[:most]) + more
