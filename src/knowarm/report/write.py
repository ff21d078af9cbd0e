"""Report writer: one self-contained HTML page, its JSON, and one CSV per table."""

import csv
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from knowarm.errors import UserError
from knowarm.escapes import csv_cell
from knowarm.reading import read_json, replacing, write_json, writing
from knowarm.report.blocks import (
    TABLES,
    Block,
    DataTable,
    Figure,
    Page,
    Row,
    TaskPart,
    Text,
    Verdict,
    flat,
)
from knowarm.report.charts import TEMPLATES
from knowarm.report.collect import collect
from knowarm.report.format import FORMATS, counted
from knowarm.report.model import StudyData
from knowarm.report.pages import (
    behaviour,
    differences,
    inputs,
    knowledge,
    paper,
    query,
    results,
    runs,
    training,
)
from knowarm.report.verdicts.claims import claims
from knowarm.report.verdicts.query import query_findings
from knowarm.svg import style_sheet

DIGITS = 9  # significant digits of every written number
FORMAT = 1  # version of the format of ``report.json``
MOVE = "Move the file, or give the report another name."
# Rows of a table that are written into the page; the CSV has all of them.
LONG_TABLE = 400
FOLDED_ROWS = 16  # rows above which a table is folded at first


def write_report(
    run_paths: Sequence[Path | str] | Path | str, out: Path | str = "runs/report.html"
) -> Path:
    """Write one report from run folders.

    Beside ``out`` it writes ``<out>.json`` with every table of the report and a folder
    ``<out>-data`` with one CSV per table. Of another report of the same name it replaces these
    files and no others. Equal folders give equal bytes.

    Args:
        run_paths: run folders, or folders that hold them at any depth; one or several.
        out: the HTML file.

    Returns:
        ``out``.

    Raises:
        UserError: there is nothing to report, ``out`` cannot be written, or a file that is not
            part of a report has one of its names.
    """
    out = Path(out)
    if out.suffix.lower() not in (".html", ".htm"):
        raise UserError(f"The report must be an .html file, got {out}.")
    with writing(out.parent):
        out.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(run_paths, str | Path):
        run_paths = [run_paths]
    study = collect([Path(path) for path in run_paths])
    pages = build_pages(study)
    page = _render(study, pages, out)
    _write_data(study, pages, out)
    with replacing(out) as temporary:
        # Lone surrogates become question marks.
        temporary.write_text(page, encoding="utf-8", errors="replace")
    return out


def build_pages(study: StudyData) -> list[Page]:
    """Build all pages that have something to show, in reading order."""
    decided = claims(study)
    understood = query_findings(study)

    def per_task(
        task_blocks: Callable[..., Sequence[Block]],
        *more: Any,
        intro: Sequence[str] = (),
    ) -> list[Block]:
        parts: list[Block] = []
        for task in study.tasks:
            blocks = task_blocks(task, *more)
            if blocks:
                parts.append(TaskPart(name=task.name, title=task.title, blocks=blocks))
        if parts and intro:
            parts.insert(0, Text(intro))
        return parts

    contents = {
        "summary": runs.summary_blocks(study, decided, understood),
        "inputs": per_task(inputs.input_blocks),
        "training": per_task(training.training_blocks),
        "results": per_task(results.result_blocks),
        "query": per_task(query.query_blocks, understood, intro=query.EXPLANATION),
        "knowledge": per_task(
            knowledge.knowledge_blocks, decided, intro=knowledge.EXPLANATION
        ),
        "differences": per_task(
            differences.difference_blocks, decided, intro=differences.EXPLANATION
        ),
        "paper": paper.paper_blocks(study),
        "joints": per_task(behaviour.joint_blocks),
        "episodes": per_task(behaviour.film_blocks),
        "runs": runs.run_blocks(study),
    }
    pages = []
    for name, blocks in contents.items():
        if blocks:
            pages.append(Page(name, **TABLES["pages"][name], blocks=blocks))
    return pages


def _write_data(study: StudyData, pages: Sequence[Page], out: Path) -> None:
    """Write the tables as CSV and JSON; paths in them are relative to the page."""
    folder = out.with_name(f"{out.stem}-data")
    tables = {}
    verdicts = []
    for page in pages:
        for block in flat(page.blocks):
            table = block.table if isinstance(block, Figure) else block
            if isinstance(table, DataTable):
                assert table.name not in tables, "two tables of one name"
                tables[table.name] = table
            if isinstance(block, Verdict):
                verdict = {
                    "page": page.name,
                    "kind": block.kind,
                    "sentence": block.sentence,
                    "reasons": block.reasons,
                }
                verdicts.append(verdict)
    _remove_earlier(out, folder, tables)
    contents = {}
    with writing(folder):
        folder.mkdir(exist_ok=True)
        for name, table in tables.items():
            contents[name] = _write_table(table, folder, out.parent)
    report = {
        "format": FORMAT,
        "knowarm": version("knowarm"),
        "tasks": [task.title for task in study.tasks],
        "runs": [run.path for run in study.runs],
        "problems": [problem._asdict() for problem in study.problems],
        "verdicts": verdicts,
        "tables": contents,
    }
    write_json(out.with_suffix(".json"), _plain(report, out.parent))


def _write_table(table: DataTable, folder: Path, start: Path) -> Row:
    """Write one table as CSV; return what the JSON holds of it."""
    columns = table.csv_columns()
    rows = []
    for row in table.flat_rows:
        values = {key: row.get(key) for key in columns}
        rows.append(_plain(values, start))
    path = folder / f"{table.name}.csv"
    with (
        replacing(path) as temporary,
        temporary.open("w", newline="", encoding="utf-8", errors="replace") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(map(_csv_cell, columns))
        for row in rows:
            writer.writerow(map(_csv_cell, row.values()))
    return {
        "title": table.title,
        "note": table.note,
        "csv": f"{folder.name}/{path.name}",
        "sources": table.sources,
        "rows": rows,
    }


def _remove_earlier(out: Path, folder: Path, names: Iterable[str]) -> None:
    """Remove the CSV files of the report that is replaced, which its JSON names, and no others."""
    report = out.with_suffix(".json")
    earlier = read_json(report) if report.is_file() else {}
    if report.exists() and not {"knowarm", "tables", "verdicts"} <= set(earlier):
        what = (
            f"{report} exists and is no report of KnowArm, whose JSON would replace it"
        )
        raise UserError(f"{what}. {MOVE}")
    tables = earlier.get("tables", ())
    earlier_files = {f"{name}.csv" for name in tables if Path(name).name == name}
    files = [folder / f"{name}.csv" for name in names]
    if folder.is_symlink():
        files = [folder]
    for path in files:
        if path.exists() and path.name not in earlier_files:
            raise UserError(f"{path} exists, and no report wrote it. {MOVE}")
    with writing(folder):
        for name in earlier_files:
            (folder / name).unlink(missing_ok=True)


def _render(study: StudyData, pages: Sequence[Page], out: Path) -> str:
    """Fill the HTML template; links are relative to the page."""
    start = out.parent
    tasks = study.tasks
    title = tasks[0].title
    if len(tasks) > 1:
        title = f"{len(tasks)} tasks, {counted(len(study.runs), 'run')}"
    script = Path(__file__).parent / "templates" / "script.js"
    return TEMPLATES.get_template("report.html.j2").render(
        title=title,
        pages=pages,
        tasks=tasks,
        many_tasks=len(tasks) > 1,
        style=Markup(style_sheet()),
        script=Markup(script.read_text(encoding="utf-8")),
        version=version("knowarm"),
        json_link=quote(out.with_suffix(".json").name),
        raw=lambda value: _raw(value, start),
        quote=quote,
        formats=FORMATS,
        data_folder=f"{out.stem}-data",
        kind=lambda block: type(block).__name__,
        long_table=LONG_TABLE,
        folded_rows=FOLDED_ROWS,
    )


def _plain(value: Any, start: Path) -> Any:
    """Return a value as JSON holds it.

    Numbers are rounded, non-finite ones None; paths are relative to the page's folder, with
    forward slashes.
    """
    if isinstance(value, Mapping):
        return {key: _plain(item, start) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item, start) for item in value]
    if isinstance(value, Path):
        return Path(os.path.relpath(value, start)).as_posix()
    if isinstance(value, float):
        if math.isfinite(value):
            return float(f"{value:.{DIGITS}g}")
        return None
    return value


def _csv_cell(value: Any) -> Any:
    """Return a value of `_plain` as the CSV holds it: text is no formula."""
    is_number = value is None or isinstance(value, int | float)
    return value if is_number else csv_cell(str(value))


def _raw(value: Any, start: Path) -> str:
    """Return a value as the page's ``data-v`` attributes hold it, like the CSV."""
    plain = _plain(value, start)
    return "" if plain is None else str(plain)
