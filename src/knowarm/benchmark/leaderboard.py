"""Leaderboard: rows of the benchmark as one HTML page and as Markdown, beside their controls."""

from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, select_autoescape
from markupsafe import Markup

from knowarm.benchmark.rows import Row, query_gain, read_row
from knowarm.benchmark.suites import CONTROLS, Suite, by_table, read_suite
from knowarm.errors import UserError
from knowarm.escapes import markdown
from knowarm.reading import write_text
from knowarm.statistics import Interval
from knowarm.svg import style_sheet

Line = dict[str, Any]
NOTHING = "–"
"""Cell of a figure that does not apply."""
BLIND = ("open-loop", "black", "frozen")
"""Controls that do not see the current image."""


def read_rows(folder: Path) -> list[Row]:
    """Read every row of a folder.

    Raises:
        UserError: there is none, or one is not valid.
    """
    rows = list(map(read_row, sorted(folder.glob("*.json"))))
    if not rows:
        raise UserError(f"There are no rows (*.json) in {folder}.")
    return rows


def tables(rows: Sequence[Row]) -> list[Line]:
    """Return one table per suite, robot and choice of colours; policies ranked by their intervals.

    A policy's rank is one more than the number of policies whose interval lies wholly above its
    own. Without rank, at the end: rows that see nothing or the simulator's state, and policies
    whose interval lies wholly below what they, or a fixed list of actions, reach blind.
    """
    result = []
    for suite_name in dict.fromkeys(map(itemgetter("suite"), rows)):
        suite = read_suite(suite_name)
        for name, cells in by_table(suite.cells.values()).items():
            lines = []
            for row in rows:
                summary = row["summary"].get(name, {})
                if row["suite"] == suite_name and summary.get("cells") == cells:
                    lines.append(_line(suite, row, summary))
            if lines:
                result.append(_table(suite, name, cells, lines))
    return result


def _table(suite: Suite, name: str, cells: list[str], lines: list[Line]) -> Line:
    """Rank the lines of a table and name its columns."""
    ranked = list(filter(itemgetter("is_ranked"), lines))
    controls = set()
    for line in lines:
        line["rank"] = 1 + sum(other["low"] > line["high"] for other in ranked)
        controls.update(line["controls"])
    lines.sort(key=lambda line: (not line["is_ranked"], -line["mean"], line["name"]))
    return {
        "suite": suite,
        "name": name,
        "cells": cells,
        "controls": [control for control in CONTROLS if control in controls],
        "has_query_gain": any(line["query_gain"] != NOTHING for line in lines),
        "lines": lines,
    }


def left_out(rows: Sequence[Row]) -> list[str]:
    """Name the rows that `tables` leaves out of a table, because they lack cells of it."""
    lines = []
    for row in rows:
        cells = by_table(read_suite(row["suite"]).cells.values())
        for name, summary in row["summary"].items():
            if len(summary["cells"]) < len(cells[name]):
                lines.append(f"{row['name']} lacks cells of {name}")
    return lines


def _line(suite: Suite, row: Row, summary: Line) -> Line:
    policy = row["policy"]
    inputs = policy["inputs"]
    controls = summary["controls"]
    cells = summary["cells"]
    blind = max(controls[name] for name in BLIND if name in controls)
    sees = bool(inputs) and "simulator" not in inputs
    count = len(policy["specs"])
    seeds = str(count)
    if policy["training"] not in ("scripted", "none") and count < suite.training_seeds:
        seeds += f" of {suite.training_seeds}"
    return {
        **policy,
        **summary["success"],
        "name": row["name"],
        "is_ranked": sees and summary["success"]["high"] >= blind,
        "sees": sees,
        "seeds": seeds,
        "controls": controls,
        "blind": blind,
        "query_gain": _points(query_gain(suite, row, cells)),
        "cells": [row["cells"][name]["success"]["mean"] for name in cells],
    }


def _points(difference: Interval | None) -> str:
    """Return a difference of shares in points, with its interval."""
    if difference is None:
        return NOTHING
    ends = (difference.estimate, difference.low, difference.high)
    return "{:+.1f} [{:+.1f}, {:+.1f}]".format(*(100 * share for share in ends))


def write_leaderboard(rows: Sequence[Row], path: Path) -> list[Path]:
    """Write ``path`` (HTML) and the same as Markdown beside it; return both paths."""
    templates = Environment(
        loader=PackageLoader("knowarm.benchmark"),
        autoescape=select_autoescape(("html.j2",)),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters["markdown"] = markdown
    templates.filters["percent"] = lambda share: f"{100 * share:.1f}"
    paths = [path.with_suffix(".html"), path.with_suffix(".md")]
    contents = {
        "tables": tables(rows),
        "controls": CONTROLS,
        "style": Markup(style_sheet()),
    }
    for file in paths:
        template = templates.get_template(f"leaderboard{file.suffix}.j2")
        text = template.render(contents)
        write_text(file, text.rstrip() + "\n")
    return paths
