"""Tests of ``benchmarks/gpu_training.py``: a training run in the result of ``bench gpu``."""

from pathlib import Path

import pytest

from benchmarks.gpu_training import add_training, training_seconds
from knowarm.errors import UserError
from knowarm.experiment.run_folder import CsvLog, RunFolder


def make_run(path: Path, total: int, steps: list[int], success: list[float]) -> RunFolder:
    folder = RunFolder.create(path)
    config = {"format": 1, "name": "irb120-full-ppo", "total_steps": total, "algorithm": {}}
    folder.write_json("config.json", config)
    for step in steps:
        CsvLog(folder.metrics_path, keep_to_step=10**9).write({"step": step, "wall_time_s": 1})
    for step, share in zip(steps, success, strict=False):
        CsvLog(folder.evaluations_path, keep_to_step=10**9).write({"step": step, "success": share})
    return folder


def test_a_whole_run_gives_its_minutes(tmp_path: Path) -> None:
    folder = make_run(tmp_path / "run", 70_000_000, [100, 70_000_100], [0.5, 0.85])
    result = add_training({"env_steps_per_s": 1.0}, folder, 420.0)
    assert result["env_steps_per_s"] == 1.0
    assert result["training_minutes_70m"] == 7.0
    training = result["training"]
    assert training["finished"]
    assert training["steps_per_s"] == pytest.approx(70_000_100 / 420)
    assert (training["evaluations"], training["best_success"]) == (2, 0.85)
    assert training["step_at_80"] == 70_000_100


@pytest.mark.parametrize(("total", "finished"), [(70_000_000, False), (200, True)])
def test_part_of_a_run_gives_none(total: int, finished: bool, tmp_path: Path) -> None:
    result = add_training({}, make_run(tmp_path / "run", total, [200], []), 60.0)
    assert result["training_minutes_70m"] is None
    assert result["training"]["finished"] is finished
    assert result["training"]["best_success"] is result["training"]["step_at_80"] is None


def test_a_run_without_a_step_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="has no metrics yet"):
        add_training({}, make_run(tmp_path / "run", 10, [], []), 1.0)


def test_times_of_commands_are_added(tmp_path: Path) -> None:
    times = tmp_path / "times"
    times.write_text("100.5 160.5\n1000 1007.25\n")
    assert training_seconds(times) == 67.25
    for text in ("", "1\n", "a b\n"):
        times.write_text(text)
        with pytest.raises(UserError, match="times"):
            training_seconds(times)
    with pytest.raises(UserError, match="Cannot read"):
        training_seconds(tmp_path / "none")
