"""Pages go in; one HTML file that needs nothing else comes out."""

from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup, escape

import knowarm
from knowarm.report.blocks import Column, Page, Row, Table
from knowarm.report.export import data_folder, raw, relative
from knowarm.report.format import FORMATS, MISSING
from knowarm.report.study import Study

MOST_SOURCES = 40
"""Links under a table; all sources stand in ``report.json``."""

LONG_TABLE = 400
"""Rows of a table that are written into the page; the CSV has all of them."""

FOLDED_ROWS = 16
"""Rows above which a table is shown on request."""


def render(study: Study, pages: Sequence[Page], out: Path) -> str:
    """Fill the template.

    Args:
        study: what the pages were made from.
        pages: the pages, in order.
        out: where the file will stand; links are relative to it.
    """
    environment = Environment(
        loader=PackageLoader("knowarm.report"),
        autoescape=select_autoescape(default=True, default_for_string=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    start = out.parent

    def source_links(table: Table) -> list[tuple[str, str]]:
        shown = dict.fromkeys(relative(path, start) for path in table.sources)
        return [(quote(path), path) for path in shown]

    environment.filters["raw"] = lambda value: raw(value, start)
    environment.globals.update(
        cell=lambda column, row: _cell(column, row, start),
        source_links=source_links,
        csv_link=lambda table: quote(f"{data_folder(out).name}/{table.name}.csv"),
        kind=lambda block: type(block).__name__,
        numeric=lambda column: column.format not in ("text", "path"),
        long_table=LONG_TABLE,
        folded_rows=FOLDED_ROWS,
        most_sources=MOST_SOURCES,
    )
    parts = {
        name: Markup((Path(__file__).parent / "templates" / name).read_text(encoding="utf-8"))
        for name in ("style.css", "script.js")
    }
    return environment.get_template("report.html.j2").render(
        title=_title(study),
        pages=pages,
        tasks=study.tasks,
        many_tasks=len(study.tasks) > 1,
        style=parts["style.css"],
        script=parts["script.js"],
        version=knowarm.__version__,
        json_link=quote(out.with_suffix(".json").name),
    )


def _title(study: Study) -> str:
    if len(study.tasks) == 1:
        return study.tasks[0].title
    return f"{len(study.tasks)} tasks, {len(study.runs)} runs"


def _cell(column: Column, row: Row, start: Path) -> Markup:
    """One cell: the value as people read it, its interval smaller beside it."""
    value = row.get(column.key)
    if column.format == "path" and isinstance(value, Path):
        path = relative(value, start)
        return Markup('<a href="{}">{}</a>').format(quote(path), path)
    shown = FORMATS[column.format](value)
    low, high = row.get(f"{column.key}_low"), row.get(f"{column.key}_high")
    if not column.interval or low is None or high is None or shown == MISSING:
        return escape(shown)
    form = FORMATS[column.format]
    return Markup('{} <span class="ci">{} to {}</span>').format(shown, form(low), form(high))
