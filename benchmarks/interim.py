"""Steps and seconds of training until 80 % of the interim episodes succeeded, from run folders.

python -m benchmarks.interim runs/irb120-full-distil/*

Seconds are wall time since the first step, interim evaluations included.
"""

import argparse
import csv
import json
from pathlib import Path
from typing import Any

from benchmarks.time_to_success import SUCCESS
from knowarm.cli.tables import print_table
from knowarm.experiment.csv_log import training_clock
from knowarm.experiment.summary import Summary

COLUMNS = (
    "run",
    "steps to 80 %",
    "seconds",
    "steps",
    "all seconds",
    "last %",
    "success %",
)


def row_of(run: Path) -> dict[str, Any]:
    """Return the figures of one run folder, by column; None where it has none."""
    evaluations, metrics = (
        list(csv.DictReader((run / name).open()))
        for name in ("evaluations.csv", "metrics.csv")
    )
    clock = training_clock(float(row["wall_time_s"]) for row in metrics)
    steps = [int(row["step"]) for row in metrics]
    seconds = dict(zip(steps, clock.tolist(), strict=True))
    reached = [
        int(row["step"]) for row in evaluations if float(row["success"]) >= SUCCESS
    ]
    first, last = min(reached, default=None), int(evaluations[-1]["step"])
    summary = run / "evaluation" / "post-training-greedy" / "summary.json"
    success = Summary.read(summary.parent)["success"] if summary.exists() else None
    values = (
        f"{run.parent.name}/{run.name}",
        first,
        None if first is None else seconds[first],
        last,
        seconds[last],
        100 * float(evaluations[-1]["success"]),
        None if success is None else 100 * success,
    )
    return dict(zip(COLUMNS, values, strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--json", type=Path, help="also write the table to this file")
    arguments = parser.parse_args()
    rows = [row_of(run) for run in arguments.runs]
    print_table("Interim evaluations", COLUMNS, [list(row.values()) for row in rows])
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
