"""The table of single changes of A3C holds what the runs of the packs reached."""

import csv

from benchmarks import a3c_changes
from scripts.answer_changes import write_changes
from tests.bench.changes import write_runs


def test_the_table_has_a_row_per_run(tmp_path):
    runs, packs = tmp_path / "runs", tmp_path / "packs"
    write_runs(runs, 2_000_000, {"none": [0.01, 0.02, 0.03]})
    write_runs(runs, 5_000_000, {"all": [0.475] * 3, "without-pixels": [0.45]})
    a3c_changes.pack(runs, packs)
    write_changes(packs, tmp_path / "changes.csv")
    rows = list(csv.DictReader((tmp_path / "changes.csv").read_text().splitlines()))
    found = [(row["steps"], row["changes"], float(row["success"])) for row in rows]
    assert found == [
        *(("2000000", "none", success) for success in (0.01, 0.02, 0.03)),
        *(("5000000", "all", 0.475) for _ in range(3)),
        ("5000000", "without-pixels", 0.45),
    ]
