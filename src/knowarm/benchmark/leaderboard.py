"""Leaderboard: rows of the benchmark as one HTML page and as Markdown, beside their controls."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, select_autoescape
from markupsafe import Markup

from knowarm.benchmark.rows import binding, read_row
from knowarm.benchmark.suites import CONTROLS, read_suite
from knowarm.errors import UserError
from knowarm.reading import replacing
from knowarm.statistics import Interval
from knowarm.svg import style_sheet

NOTHING = "–"
"""Cell of a figure that does not apply."""
BLIND = ("open-loop", "black", "frozen")
"""Controls that do not see the current image."""


def read_rows(folder: Path) -> list[dict[str, Any]]:
    """Read every row of a folder.

    Raises:
        UserError: there is none, or one is not valid.
    """
    rows = [read_row(path) for path in sorted(folder.glob("*.json"))]
    if not rows:
        raise UserError(f"There are no rows (*.json) in {folder}.")
    return rows


def tables(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one table per suite, robot and choice of colours; policies ranked by their intervals.

    A policy's rank is one more than the number of policies whose interval lies wholly above its
    own. Rows that see nothing, or the simulator's state, are references: without rank, at the end.
    """
    result = []
    for suite in (read_suite(name) for name in dict.fromkeys(row["suite"] for row in rows)):
        for name in dict.fromkeys(cell.table for cell in suite.cells.values()):
            cells = [key for key, cell in suite.cells.items() if cell.table == name]
            complete = [
                row
                for row in rows
                if row["suite"] == suite.name and row["summary"].get(name, {}).get("cells") == cells
            ]
            lines = [_line(row, name, cells, suite.training_seeds) for row in complete]
            ranked = [
                line for line in lines if line["inputs"] and "simulator" not in line["inputs"]
            ]
            for line, row in zip(lines, complete, strict=True):
                line["binding"] = _points(binding(suite, row, cells))
                line["rank"] = 1 + sum(other["low"] > line["high"] for other in ranked)
                line["is_ranked"] = line in ranked
            lines.sort(key=lambda line: (not line["is_ranked"], -line["mean"], line["name"]))
            controls = [c for c in CONTROLS if any(c in line["controls"] for line in lines)]
            table = {"suite": suite, "name": name, "cells": cells, "controls": controls}
            table["binds"] = any(line["binding"] != NOTHING for line in lines)
            result.append(table | {"lines": lines, "short": [c.partition("-")[2] for c in cells]})
    return [table for table in result if table["lines"]]


def left_out(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Name the rows that `tables` leaves out of a table, because they lack cells of it."""
    return [
        f"{row['name']} lacks cells of {name}"
        for row in rows
        for name, summary in row["summary"].items()
        if len(summary["cells"])
        < sum(c.table == name for c in read_suite(row["suite"]).cells.values())
    ]


def _line(row: dict[str, Any], table: str, cells: list[str], wanted: int) -> dict[str, Any]:
    summary, policy = row["summary"][table], row["policy"]
    seeds = len(policy["specs"])
    trained = policy["training"] not in ("scripted", "none")
    return {
        "name": row["name"],
        "inputs": policy["inputs"],
        "training": policy["training"],
        "seeds": f"{seeds} of {wanted}" if trained and seeds < wanted else str(seeds),
        "controls": summary["controls"],
        "blind": max(share for name, share in summary["controls"].items() if name in BLIND),
        "cells": [row["cells"][name]["success"]["mean"] for name in cells],
        **{end: summary["success"][end] for end in ("mean", "low", "high")},
    }


def _points(found: Interval | None) -> str:
    """Return a difference of shares in points, with its interval."""
    if found is None:
        return NOTHING
    return "{:+.1f} [{:+.1f}, {:+.1f}]".format(
        *(100 * end for end in (found.estimate, found.low, found.high))
    )


def write_leaderboard(rows: Sequence[dict[str, Any]], path: Path) -> list[Path]:
    """Write ``path`` (HTML) and the same as Markdown beside it; return both paths."""
    templates = Environment(
        loader=PackageLoader("knowarm.benchmark"),
        autoescape=select_autoescape(("html.j2",)),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters["percent"] = lambda share: f"{100 * share:.1f}"
    written = [path.with_suffix(".html"), path.with_suffix(".md")]
    for file in written:
        page = templates.get_template(f"leaderboard{file.suffix}.j2")
        text = page.render(tables=tables(rows), controls=CONTROLS, style=Markup(style_sheet()))
        with replacing(file) as temporary:
            temporary.write_text(text.rstrip() + "\n", encoding="utf-8")
    return written
