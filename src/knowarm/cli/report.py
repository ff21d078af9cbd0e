"""``knowarm report`` and ``knowarm export``: files made from run folders."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from knowarm.cli.tables import TableCommand
from knowarm.experiment.load import Which, load_agent
from knowarm.policy.onnx_export import INPUTS, OUTPUTS, export_onnx
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
            print(f"Note: {', '.join(map(str, problem.values()))}")
        print(f"Wrote {path}: open it in a browser.")
        return values


@dataclass(frozen=True, kw_only=True)
class Export:
    """Write a trained policy as an ONNX model of one time step."""

    run_folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    """Run folder, such as runs/irb120-full-fast/0."""
    out: Path = Path("policy.onnx")
    """ONNX file to write."""
    which: Which = "best"
    """Checkpoint of the run: best interim evaluation, latest, or untrained."""

    def run(self) -> None:
        """Export the policy and print the names of its inputs and outputs."""
        trained = load_agent(self.run_folder, which=self.which)
        export_onnx(trained.policy, self.out)
        print(f"Wrote {self.out}: inputs {', '.join(INPUTS)}; outputs {', '.join(OUTPUTS)}.")
        print("The knowledge vector of each facet is a row of the run's knowledge.safetensors.")
