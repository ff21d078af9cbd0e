"""Figures in the style of the reports: charts, dots per training seed, films of episodes."""

import base64
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from knowarm.experiment.summary import Summary
from knowarm.report.charts import Axis, Box, Scale, percent_axis
from knowarm.svg import drawing, element, escape, label, style_sheet, text_width
from knowarm.world.viewing.record import Frame

FRAME_MS, LAST_MS = 90, 1_400
"""Display time of each image of a film, and of the last [ms]."""


def style() -> str:
    """Return what a drawing uses of the reports' style sheet: light colours, and its marks."""
    colours, *others = style_sheet().split("\n\n")
    (marks,) = (each for each in others if each.startswith("svg text"))
    light = re.sub(
        r"light-dark\((.+?), [^;]+\);", r"\1;", colours.replace("light dark", "light")
    )
    light = re.sub(r"(?m)^:root\..*\n", "", light)  # the user's choice of a page
    return f"{light}\n{marks}\n"


@dataclass(frozen=True)
class Shown:
    """HTML that a notebook displays."""

    html: str

    def _repr_html_(self) -> str:
        return self.html


def picture(
    drawings: Sequence[str],
    box: Box,
    legend: Mapping[str, str],
    columns: int = 0,
    titles: Sequence[str] = (),
) -> str:
    """Return a standalone SVG of equal drawings under one legend.

    Args:
        drawings: inline SVG elements, each of the size of ``box``.
        box: their size.
        legend: palette class by name; names that need more than one line are not supported.
        columns: drawings beside each other; 0 places all in one row.
        titles: one per drawing, shown at its top right.
    """
    top = 34 if legend else 0
    parts = [element("style", escape(style()))]
    parts.append(element("rect", width="100%", height="100%", fill="#ffffff"))
    x = box.left
    for name, colour in legend.items():
        swatch = element("rect", x=x, y=13, width=14, height=4, fill="var(--c)")
        parts.append(element("g", swatch, class_=colour))
        parts.append(label(x + 20, 20, name, class_="row-name"))
        x += 44 + text_width(name)
    for i, each in enumerate(drawings):
        row, column = divmod(i, columns or len(drawings))
        at = f"translate({column * box.width} {row * box.height + top})"
        shown = [each]
        if titles:
            end = {"class_": "row-name", "text_anchor": "end"}
            shown.append(label(box.x[1], box.top - 11, titles[i], **end))
        parts.append(element("g", *shown, transform=at))
    columns = columns or len(drawings)
    size = (
        f"0 0 {columns * box.width} {-(-len(drawings) // columns) * box.height + top}"
    )
    svg = element(
        "svg", *parts, viewBox=size, class_="light", xmlns="http://www.w3.org/2000/svg"
    )
    return svg + "\n"


def dots(
    scores: Mapping[str, Mapping[str, Sequence[float]]],
    name: str,
    title: str | Axis,
    low: float = 0.0,
    spans: Mapping[str, Mapping[str, tuple[float, float]]] | None = None,
) -> str:
    """Draw one dot per value, such as the success of a training seed.

    Args:
        scores: for each row, values by palette class.
        name: text alternative.
        title: title of an axis in per cent, or another axis with its range.
        low: start of the axis in per cent, as a fraction.
        spans: for each row, the ends of an interval by palette class.

    Returns:
        An inline SVG element of the size of `dots_box`.
    """
    box = dots_box(scores)
    axis = percent_axis(title) if isinstance(title, str) else title
    start, end = axis.range or (0.0, 1.0)
    x = Scale(max(low, start), end, *box.x)
    parts = []
    for value, words in zip(x.ticks(5), axis.labels(x.ticks(5)), strict=True):
        at = x(value)
        parts.append(
            element("line", class_="grid", x1=at, x2=at, y1=box.top, y2=box.y[0])
        )
        parts.append(
            label(at, box.y[0] + 17, words, class_="tick", text_anchor="middle")
        )
    parts.append(
        label(
            box.x[1], box.y[0] + 33, axis.title, class_="axis-title", text_anchor="end"
        )
    )
    for i, (row, groups) in enumerate(scores.items()):
        y = box.top + 26 * i + 13
        parts.append(
            label(box.left - 10, y + 4, row, class_="row-name", text_anchor="end")
        )
        offset = -3.5 * (len(groups) - 1)
        for j, (colour, values) in enumerate(groups.items()):
            at = y + offset + 7 * j
            marks = [
                element("circle", cx=x(v), cy=at, r=4.2, opacity=0.75) for v in values
            ]
            if spans:
                low_end, high_end = (x(end) for end in spans[row][colour])
                line = {"x1": low_end, "x2": high_end, "y1": at, "y2": at}
                marks.append(element("line", **line, stroke="var(--c)", stroke_width=2))
            parts.append(element("g", *marks, class_=colour, fill="var(--c)"))
    return drawing(box.width, box.height, name, *parts, class_="chart")


def dots_box(scores: Mapping[str, object], width: float = 660) -> Box:
    """Return the size of a drawing of `dots`."""
    left = max(text_width(row, 12) for row in scores) + 18
    return Box(width=width, height=26 * len(scores) + 50, left=left, top=6)


def shown(svg: str, alt: str) -> Shown:
    """Show a standalone SVG in a notebook."""
    data = base64.b64encode(svg.encode()).decode()
    return Shown(
        f'<img src="data:image/svg+xml;base64,{data}" alt="{escape(alt, quote=True)}">'
    )


def film(frames: Sequence[Frame], alt: str, side: int = 280) -> Shown:
    """Show an episode in a notebook: the large view, and the image that the policy receives."""
    images = []
    for frame in frames:
        sheet = Image.new("RGB", (2 * side + 8, side), (255, 255, 255))
        sheet.paste(Image.fromarray(frame.large).resize((side, side)), (0, 0))
        small = Image.fromarray(frame.policy).resize(
            (side, side), Image.Resampling.NEAREST
        )
        sheet.paste(small, (side + 8, 0))
        images.append(sheet)
    buffer = io.BytesIO()
    durations = [FRAME_MS] * (len(images) - 1) + [LAST_MS]
    images[0].save(
        buffer,
        "WEBP",
        save_all=True,
        append_images=images[1:],
        duration=durations,
        loop=0,
        quality=70,
    )
    data = base64.b64encode(buffer.getvalue()).decode()
    return Shown(
        f'<img src="data:image/webp;base64,{data}" alt="{escape(alt, quote=True)}">'
    )


def seed_scores(folder: Path, experiment: str, key: str, split: str = "") -> np.ndarray:
    """Read a figure of every training seed's evaluation from an unpacked study.

    Args:
        folder: the study.
        experiment: name of a folder in it.
        key: name of a field of the evaluation's summary, such as ``success`` or ``choice``.
        split: of a choose task, such as ``s4``.

    Returns:
        (n,) float64, by training seed.
    """
    pattern = f"*/evaluation/*{'-' + split if split else ''}/summary.json"
    paths = sorted((folder / experiment).glob(pattern))
    return np.array([Summary.read(path.parent)[key] for path in paths])
