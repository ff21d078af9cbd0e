"""Sound part of a study: a report of all runs except what is damaged."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from knowarm.errors import UserError
from knowarm.reading import one_line
from knowarm.report.blocks import Page
from knowarm.report.collect import arrange
from knowarm.report.pages import build_pages
from knowarm.report.read import read_folders
from knowarm.report.study import Problem, Reference, Run, Study

PARTS: tuple[tuple[dict[str, Any], str], ...] = (
    ({}, ""),
    ({"provenance": {}}, "kept; versions and parameters unknown"),
    ({"evaluations": {}}, "kept without its post-training evaluations"),
    ({"provenance": {}, "evaluations": {}}, "kept; only its curves are shown"),
)
"""What is left of a run that cannot be reported as a whole, and how it is said."""


Render = Callable[[Study, Sequence[Page]], str]
"""Writes the pages as HTML."""


def build_report(
    paths: Sequence[Path], references: Mapping[str, Path], render: Render
) -> tuple[Study, list[Page], str]:
    """Read run folders and build the pages of their report.

    Files may be damaged in more ways than reading them shows: a wrong type or a missing number
    anywhere in them. If the report cannot be built, each run is tried alone, and the parts that
    fail are left out and listed among the problems.

    Args:
        paths: run folders, or folders that hold them at any depth.
        references: evaluation folders of policies that have no run, by name.
        render: writes the pages as HTML.

    Raises:
        UserError: nothing is left to report.
    """
    runs, known, problems = read_folders(paths, references)
    try:
        return _build(runs, known, problems, render)
    except UserError:
        raise
    except Exception as error:
        sound = [part for run in runs if (part := _sound_part(run, problems, render)) is not None]
        if not sound:
            raise UserError(
                f"Nothing to report: {problems[-1].path} is damaged ({problems[-1].what})."
            ) from error
        by_path = [(reference.evaluations[0].folder, reference) for reference in known]
        for folder, reference in by_path:
            if (reason := _failure(sound[:1], [reference], render)) is not None:
                known.remove(reference)
                problems.append(Problem(folder, f"damaged: {reason}", "left out"))
        return _build(sound, known, problems, render)


def _build(
    runs: list[Run], references: list[Reference], problems: list[Problem], render: Render
) -> tuple[Study, list[Page], str]:
    study = arrange(runs, references, problems)
    pages = build_pages(study)
    return study, pages, render(study, pages)


def _sound_part(run: Run, problems: list[Problem], render: Render) -> Run | None:
    """Return the largest part of a run of which a report can be built, or None."""
    first = None
    for changes, done in PARTS:
        part = replace(run, **changes)
        reason = _failure([part], [], render)
        if reason is None:
            if first is not None:
                problems.append(Problem(run.path, f"damaged: {first}", done))
            return part
        first = first or reason
    problems.append(Problem(run.path, f"damaged: {first}", "left out"))
    return None


def _failure(runs: list[Run], references: list[Reference], render: Render) -> str | None:
    try:
        _build(runs, references, [], render)
    except Exception as error:
        return one_line(error)
    return None
