"""Steps to success from run folders."""

import json

from benchmarks.interim import row_of


def test_the_first_evaluation_with_80_percent_and_its_time_are_reported(tmp_path):
    run = tmp_path / "irb120-full-distil" / "3"
    folder = run / "evaluation" / "post-training-greedy"
    folder.mkdir(parents=True)
    (run / "evaluations.csv").write_text(
        "step,success\n0,0.0\n512,0.75\n1024,0.8\n1536,0.9\n"
    )
    (run / "metrics.csv").write_text("step,wall_time_s\n512,3.5\n1024,6.0\n1536,8.5\n")
    assert list(row_of(run).values()) == [
        "irb120-full-distil/3",
        1024,
        6.0,
        1536,
        8.5,
        90.0,
        None,
    ]
    numbers = {"episodes": 4, "success": 0.5, "accuracy": 0.5, "return_mean": 1.0}
    known = {
        "format": 2,
        "agent": "",
        "label": "",
        "config": {},
        "env": {},
        "groups": {},
    }
    (folder / "summary.json").write_text(json.dumps(known | {"numbers": numbers}))
    assert row_of(run)["success %"] == 50.0
    (run / "evaluations.csv").write_text("step,success\n0,0.0\n512,0.75\n")
    assert row_of(run)["steps to 80 %"] is None
