"""Paths of run folders go in; ``report.html``, ``report.json`` and CSVs come out."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from knowarm.errors import UserError
from knowarm.report.export import write_data
from knowarm.report.html import render
from knowarm.report.pages import build_pages
from knowarm.report.study import collect


def report(
    run_paths: Sequence[Path],
    out: Path,
    reference_results: Mapping[str, Path] | None = None,
) -> Path:
    """Write one report from run folders.

    Beside ``out`` there are ``<out>.json`` with every table of the report and a folder
    ``<out>-data`` with one CSV a table. The same folders give the same bytes.

    Args:
        run_paths: run folders, or folders that hold them at any depth.
        out: the HTML file.
        reference_results: more evaluation folders, of policies without a run (scripted ones),
            by the name the report shows. One is shown with the tasks whose episodes it played.
            Evaluations of untrained policies inside the run folders are found by themselves.

    Returns:
        ``out``.

    Raises:
        UserError: nothing to report, or ``out`` cannot be written.
    """
    if out.suffix.lower() not in (".html", ".htm"):
        raise UserError(f"The report must be an .html file, got {out}.")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"Cannot write to {out.parent}: {error.strerror}.") from error
    study = collect(run_paths, reference_results)
    pages = build_pages(study)
    write_data(study, pages, out)
    page = render(study, pages, out)
    temporary = out.with_name(out.name + ".tmp")
    try:
        temporary.write_text(page, encoding="utf-8")
        temporary.replace(out)
    except OSError as error:
        raise UserError(f"Cannot write {out}: {error.strerror}.") from error
    return out
