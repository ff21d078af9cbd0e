"""Draw how a graph joins an image in a policy, for docs/concepts.md.

python -m scripts.draw_concepts    # writes docs/images/concepts.svg
"""

from pathlib import Path

from knowarm.svg import document, element, label, text_width

OUT = Path("docs/images/concepts.svg")
WIDTH, ROW, BOX_H, GAP = 980, 150, 46, 34
BLUE, GREY, INK = "#2166ac", "#7c8088", "#1c1e22"

ROWS = {
    "1. A constant vector (reach)": (
        ("graph", "554 triples"),
        ("one slot per object", "Gamma, sentence, vectors"),
        ("150 numbers", "the same in every episode"),
        ("LSTM", "beside the image's features"),
    ),
    "2. The vector of a query (choose)": (
        ("query, graph", "usedFor drinking"),
        ("one slot per condition", "value and its subgraph"),
        ("grounding network", "scores places by vectors"),
        ("LSTM", "beside the image's features"),
    ),
    "3. The answer of the graph (choose, ask)": (
        ("question, graph", "usedFor drinking"),
        ("objects that answer", "mug, bottle, can, glass"),
        ("grounding network", "names objects at places"),
        ("LSTM", "beside the image's features"),
    ),
}


def box(x: float, y: float, width: float, words: tuple[str, str], colour: str) -> str:
    """Draw a box with a name and a line below it."""
    middle = {"text_anchor": "middle", "fill": INK}
    return element(
        "g",
        element(
            "rect",
            x=x,
            y=y,
            width=width,
            height=BOX_H,
            rx=6,
            fill="#ffffff",
            stroke=colour,
            stroke_width=1.6,
        ),
        label(x + width / 2, y + 20, words[0], font_weight="bold", **middle),
        label(x + width / 2, y + 37, words[1], font_size=11, **middle),
    )


def arrow(x0: float, y0: float, x1: float, y1: float) -> str:
    """Draw an arrow with its tip at the second point."""
    tip = f"M{x1 - 8:.1f} {y1 - 4:.1f}L{x1:.1f} {y1:.1f}L{x1 - 8:.1f} {y1 + 4:.1f}Z"
    line = element(
        "line", x1=x0, y1=y0, x2=x1 - 6, y2=y1, stroke=GREY, stroke_width=1.6
    )
    return line + element("path", d=tip, fill=GREY)


def main() -> None:
    """Write the drawing."""
    parts = []
    for number, (title, boxes) in enumerate(ROWS.items()):
        top = 18 + number * ROW
        parts.append(label(14, top, title, font_weight="bold", fill=BLUE))
        width = max(text_width(line, 11.5) for words in boxes for line in words) + 14
        x, y = 14.0, top + 12
        for i, words in enumerate(boxes):
            parts.append(box(x, y, width, words, BLUE))
            end = x + width
            parts.append(arrow(end, y + BOX_H / 2, end + GAP, y + BOX_H / 2))
            x = end + GAP if i < len(boxes) - 1 else end
        parts.append(label(x + GAP + 4, y + 20, "joint", fill=INK))
        parts.append(label(x + GAP + 4, y + 36, "steps", fill=INK))
        # The image enters the last box, and the grounding network where there is one.
        image = y + BOX_H + 22
        parts.append(box(14, image, width, ("image", "64 x 64 pixels"), GREY))
        for target in (2, 3) if number else (3,):
            at = 14 + target * (width + GAP) + width / 2
            parts.append(
                element(
                    "path",
                    d=f"M{14 + width:.1f} {image + BOX_H / 2:.1f}H{at:.1f}V{y + BOX_H + 6:.1f}",
                    fill="none",
                    stroke=GREY,
                    stroke_width=1.6,
                )
            )
            tip = y + BOX_H
            parts.append(
                element(
                    "path",
                    d=f"M{at - 4:.1f} {tip + 8}L{at:.1f} {tip}L{at + 4:.1f} {tip + 8}Z",
                    fill=GREY,
                )
            )
    name = "Three ways in which a knowledge graph joins an image in a policy"
    text = document(WIDTH, len(ROWS) * ROW + 10, name, *parts)
    OUT.write_text(text, encoding="utf-8")
    print(f"Wrote {OUT}")


if __name__ == "__main__":
    main()
