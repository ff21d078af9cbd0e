"""Triples go in; a drawing of objects, what is said about them, and by which relation comes out."""

from collections.abc import Sequence

from knowarm.report.figures.svg import drawing, element, hover, label

ROW = 17
GAP = 7
HUB_X = 108.0
TAIL_X = 232.0
MOST = 90
"""Facts drawn; a larger subgraph is drawn in part and listed whole in the table."""

HUES = ("h0", "h1", "h2", "h3", "h4", "h5")


def graph_drawing(triples: Sequence[tuple[str, str, str]], title: str) -> str:
    """Draw heads left, tails right, grouped by relation; what two heads share has two lines.

    Args:
        triples: (head, relation, tail) words, at most `MOST` of which are drawn.
        title: what a screen reader says.
    """
    width = 430.0
    heads = list(dict.fromkeys(head for head, _, _ in triples))
    facts: dict[tuple[str, str], list[str]] = {}
    for head, relation, tail in sorted(triples, key=lambda t: (t[1], heads.index(t[0]), t[2])):
        facts.setdefault((relation, tail), []).append(head)
    drawn = list(facts.items())[:MOST]
    tails, y, last = [], 4.0, ""
    places: dict[tuple[str, str], float] = {}
    for (relation, tail), _ in drawn:
        if relation != last:
            y += GAP if last else 0
            tails.append(label(width, y + 12, relation, class_="relation", text_anchor="end"))
            last = relation
        places[relation, tail] = y + 8
        tails.append(label(TAIL_X, y + 12, tail, class_="tail"))
        y += ROW
    height = y + 4
    hubs = {head: height * (i + 0.5) / len(heads) for i, head in enumerate(heads)}
    links = []
    for (relation, tail), owners in drawn:
        for head in owners:
            links.append(_link(hubs[head], places[relation, tail], heads.index(head)))
            links[-1] = links[-1].replace("/>", f">{hover(f'{head} {relation} {tail}')}</path>")
    nodes = [
        element(
            "g",
            element("circle", cx=HUB_X, cy=at, r=6, class_="hub"),
            label(HUB_X - 12, at + 4, head, class_="head", text_anchor="end"),
            class_=HUES[i % len(HUES)],
        )
        for i, (head, at) in enumerate(hubs.items())
    ]
    return drawing(width, height, title, *links, *tails, *nodes, class_="chart graph")


def _link(start: float, end: float, index: int) -> str:
    x0, x1 = HUB_X + 6, TAIL_X - 6
    middle = (x0 + x1) / 2
    curve = f"M{x0:.1f} {start:.1f}C{middle:.1f} {start:.1f} {middle:.1f} {end:.1f} {x1} {end:.1f}"
    return element("path", d=curve, class_=f"edge {HUES[index % len(HUES)]}")
