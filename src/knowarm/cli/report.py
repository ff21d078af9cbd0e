"""``knowarm report``: one page that compares runs."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from knowarm.cli.tables import TableCommand
from knowarm.reading import read_json
from knowarm.report import write_report


@dataclass(frozen=True, kw_only=True)
class Report(TableCommand):
    """Write one self-contained HTML report, and its numbers as JSON and CSV."""

    runs: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="RUN...", help_behavior_hint="(required)"),
    ]
    """Run folders, or folders that contain them at any depth."""
    out: Path = Path("runs/report.html")
    """HTML file; the JSON and CSV files are written to the same folder."""

    def result(self) -> dict[str, Any]:
        """Write the report and return its numbers."""
        path = write_report(self.runs, self.out)
        values = read_json(path.with_suffix(".json"))
        for problem in values["problems"]:
            where = os.path.relpath(path.parent / problem["path"])
            print(f"Note: {where}, {problem['what']}, {problem['done']}")
        print(f"Wrote {path}: open it in a browser.")
        return values
