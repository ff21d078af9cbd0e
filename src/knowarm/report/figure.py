"""Figures and tables of a paper: curves, bars and film strips, LaTeX and Markdown."""

import base64
import io
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from PIL import Image

from knowarm.errors import UserError, packages_of
from knowarm.escapes import latex, markdown
from knowarm.reading import replacing, write_text
from knowarm.report.blocks import Column, DataTable, Films, Verdict
from knowarm.report.charts import SUCCESS_AXIS, TEMPLATES
from knowarm.report.collect import collect
from knowarm.report.format import FORMATS, NARROW_SPACE, percent, steps
from knowarm.report.model import StudyData
from knowarm.report.pages.behaviour import STRIP_FRAMES, film_blocks
from knowarm.report.pages.runs import results_figure, summary_blocks
from knowarm.report.pages.training import curve_lines
from knowarm.report.verdicts.claims import claims
from knowarm.report.verdicts.query import query_findings
from knowarm.statistics import Interval
from knowarm.svg import style_sheet

Kind = Literal["curves", "bars", "films"]
COLOURS = {
    f"c-{name}": colour
    for name, colour in re.findall(
        r"--(\w+): light-dark\((#\w{6}),", style_sheet().replace("\n", " ")
    )
}
"""Colours of the report on white paper, by palette class."""
STYLE: Any = {
    "font.size": 8,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "text.parse_math": False,  # names are no formulas
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "knowarm",
}
DATES = {".pdf": "CreationDate", ".svg": "Date", ".png": "Software"}
"""Metadata of each format of a drawing that would differ between equal figures."""
WIDTH = 3.5  # of a panel [in]
ROW = 0.6  # height of a film strip [in]
LETTERS = 17  # of the caption per inch


def write_figure(
    run_paths: Sequence[Path | str],
    out: Path | str,
    *,
    kind: Kind | None = None,
    caption: bool = True,
) -> str:
    """Write a figure or table of runs, and return its caption: the verdict of their report.

    Equal folders give equal bytes.

    Args:
        run_paths: run folders, or folders that hold them at any depth.
        out: a drawing (.pdf, .svg, .png) or a table (.tex, .md).
        kind: of a drawing: curves of success over steps, bars of success after training, or film
            strips; None draws curves.
        caption: whether the caption stands below the drawing.

    Raises:
        UserError: the runs have nothing of this kind, or a package or the suffix is missing.
    """
    out = Path(out)
    suffix = out.suffix.lower()
    if suffix not in DATES and suffix not in TABLES:
        allowed = ", ".join([*DATES, *TABLES])
        raise UserError(f"A figure or table ends in {allowed}, got {out.name!r}.")
    if suffix in TABLES and kind is not None:
        raise UserError(f"A table ({suffix}) has no kind: leave it out.")
    study = collect([Path(path) for path in run_paths])
    verdict = summary_blocks(study, claims(study), query_findings(study))[0]
    assert isinstance(verdict, Verdict)
    if suffix in TABLES:
        if not any(task.label for task in study.tasks):
            raise UserError(
                "No run has a post-training evaluation, which the table shows: run "
                "`knowarm evaluate RUN` first."
            )
        text = _table(results_figure(study).table, verdict.sentence, suffix)
        write_text(out, text)
        return verdict.sentence
    kind = kind or "curves"
    draw, reading_aid = DRAWINGS[kind]
    sentence = f"{verdict.sentence} {reading_aid}"
    with packages_of("figure", "A figure"):
        import matplotlib
        from matplotlib.figure import Figure
    with matplotlib.rc_context(STYLE):
        drawing = Figure(layout="constrained")
        draw(drawing, study)
        if caption:
            width = round(LETTERS * drawing.get_figwidth())
            lines = textwrap.fill(sentence, width)
            drawing.supxlabel(lines, x=0.01, ha="left", fontsize=7)
        with replacing(out) as temporary:
            drawing.savefig(
                temporary, format=suffix[1:], dpi=300, metadata={DATES[suffix]: None}
            )
    return sentence


def _panels(drawing: Any, study: StudyData, height: float) -> list[Any]:
    """Return one plot per task, side by side, with its title where there are several."""
    tasks = study.tasks
    drawing.set_size_inches(WIDTH * len(tasks), height)
    panels = list(drawing.subplots(1, len(tasks), squeeze=False)[0])
    if len(tasks) > 1:
        for panel, task in zip(panels, tasks, strict=True):
            panel.set_title(textwrap.fill(task.title, 44), fontsize=8)
    return panels


def _curves(drawing: Any, study: StudyData) -> None:
    """Draw the success of interim evaluations over the steps."""
    panels = _panels(drawing, study, 2.8)
    for panel, task in zip(panels, study.tasks, strict=True):
        lines = curve_lines(task, ["success"]).get("success", [])
        if not lines:
            raise UserError(f"No run of {task.title} has interim evaluations to draw.")
        handles = []
        for line in lines:
            colour = COLOURS[line.colour]
            for x, y in line.faint:
                panel.plot(x, y, color=colour, alpha=0.28, linewidth=0.5)
            if line.band is not None:
                panel.fill_between(
                    line.x, *line.band, color=colour, alpha=0.16, linewidth=0
                )
            style = "--" if line.dashed else "-"
            handles += panel.plot(line.x, line.y, style, color=colour)
        names = [line.name for line in lines]
        panel.legend(handles, names, frameon=False)
        panel.set_xlabel("environment steps")
        panel.xaxis.set_major_formatter(lambda value, _: steps(value))
        _set_success(panel, panel.yaxis)
        panel.set_ylim(0, 1)


def _bars(drawing: Any, study: StudyData) -> None:
    """Draw the success after training: bars with intervals, or with the few training seeds."""
    tasks = study.tasks
    most = max(len(task.agents) for task in tasks)
    panels = _panels(drawing, study, 1.2 + 0.3 * most)
    for panel, task in zip(panels, tasks, strict=True):
        agents = [agent for agent in task.agents if agent.level("success")]
        if not agents:
            raise UserError(
                f"No run of {task.title} has a post-training evaluation to draw: run "
                "`knowarm evaluate RUN` first."
            )
        for row, agent in enumerate(agents):
            success = agent.level("success")
            assert success is not None
            colour = COLOURS[agent.colour]
            mean = success.estimate
            panel.barh(row, mean, 0.7, color=colour, alpha=0.5)
            if success.runs:
                heights = np.full(len(success.runs), row)
                panel.plot(success.runs, heights, "o", color="black", markersize=3)
            else:
                ends = [[mean - success.low], [success.high - mean]]
                panel.errorbar(mean, row, xerr=ends, color="black", capsize=2)
        panel.set_yticks(range(len(agents)), [agent.name for agent in agents])
        panel.set_ylim(most - 0.5, -0.5)
        _set_success(panel, panel.xaxis)
        panel.set_xlim(0, 1)


def _set_success(panel: Any, axis: Any) -> None:
    """Label an axis of a panel as success in per cent."""
    axis.set_label_text(SUCCESS_AXIS.title)
    axis.set_major_formatter(lambda value, _: percent(value, 0))


def _films(drawing: Any, study: StudyData) -> None:
    """Draw film strips: a row per agent and episode."""
    films: list[Films] = []
    for task in study.tasks:
        films += film_blocks(task)
    count = sum(len(block.films) for block in films)
    if not count:
        raise UserError(
            "No run has films of common episodes: run `knowarm evaluate RUN` first."
        )
    drawing.set_size_inches(2 * WIDTH, ROW * count + 0.3 * len(films) + 0.5)
    heights = [len(block.films) for block in films]
    parts = drawing.subfigures(len(films), 1, squeeze=False, height_ratios=heights)
    for part, block in zip(parts[:, 0], films, strict=True):
        part.suptitle(block.title, fontsize=8)
        cells = part.subplots(len(block.films), STRIP_FRAMES, squeeze=False)
        for row, film in zip(cells, block.films, strict=True):
            for cell in row:
                cell.axis("off")
            for cell, (uri, label) in zip(row, film.strip, strict=False):
                data = base64.b64decode(uri.partition(",")[2])
                picture = Image.open(io.BytesIO(data))
                # Clip paths have random names
                cell.imshow(picture, interpolation="nearest", clip_on=False)
                cell.set_title(label, fontsize=6, pad=2)
            row[0].text(
                -0.08,
                0.5,
                film.name,
                ha="right",
                va="center",
                transform=row[0].transAxes,
            )


DRAWINGS: Mapping[Kind, tuple[Callable[[Any, StudyData], None], str]] = {
    "curves": (
        _curves,
        "Lines: mean over training seeds; bands: its 95 % interval; thin: each seed; dashed: "
        "controls of size and content.",
    ),
    "bars": (
        _bars,
        "Bars: mean; whiskers: its 95 % interval, of one seed over episodes; dots: seeds, "
        "where they are too few for one.",
    ),
    "films": (_films, "Images that the policy received."),
}
"""How each kind is drawn, and how to read it."""


TABLES: Mapping[str, Callable[[str], str]] = {".tex": latex, ".md": markdown}
"""How the text of each format of a table is escaped."""


def _table(table: DataTable, caption: str, suffix: str) -> str:
    """Return a table below its caption, without columns that are empty."""
    escape = TABLES[suffix]
    columns = list(table.columns)
    for column in table.columns:
        if all(row.get(column.key) is None for row in table.rows):
            columns.remove(column)
    rows = []
    for row in table.rows:
        texts = [_text(column, row.get(column.key)) for column in columns]
        rows.append(map(escape, texts))
    return TEMPLATES.get_template(f"table{suffix}.j2").render(
        caption=escape(f"{caption} {table.title}."),
        heads=[escape(column.label) for column in columns],
        rows=rows,
    )


def _text(column: Column, value: Any) -> str:
    """Return a value with its interval, or with its few training seeds."""
    form = FORMATS[column.format]
    if not isinstance(value, Interval):
        text = form(value)
    else:
        text = form(value.estimate)
        if value.runs:
            text += f" ({', '.join(map(form, value.runs))})"
        elif value.low < value.high:
            text += f" [{form(value.low)}, {form(value.high)}]"
    return text.replace(NARROW_SPACE, " ")
