"""``knowarm report``: run folders go in; one HTML page comes out."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from knowarm.cli.tables import check_json_path
from knowarm.experiment.run_folder import read_json
from knowarm.report import report


@dataclass(frozen=True, kw_only=True)
class Report:
    """Write one self-contained HTML report, with its numbers as JSON and CSV beside it."""

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Run folders, or folders that hold them at any depth."""
    out: Path = Path("runs/report.html")
    """The HTML file."""
    json: Path | None = None
    """Also copy the report's JSON to this file."""

    def run(self) -> None:
        """Write the report."""
        check_json_path(self.json)
        path = report(self.runs, self.out)
        values = read_json(path.with_suffix(".json"))
        for problem in values["problems"]:
            print(f"Note: {': '.join(map(str, problem.values()))}")
        print(f"Wrote {path}: open it in a browser.")
        if self.json is not None:
            self.json.write_bytes(path.with_suffix(".json").read_bytes())
            print(f"Wrote {self.json}")


COMMAND = Report
