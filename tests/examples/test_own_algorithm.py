"""The example ``own_algorithm``: trained, resumed to the byte, evaluated and found by its name."""

import dataclasses
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from knowarm.cli.main import _parse, main
from knowarm.errors import UserError
from knowarm.experiment.algorithms import (
    ALGORITHMS,
    VARIABLE,
    algorithms,
    register_algorithm,
)
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run import train
from knowarm.learn import read_checkpoint
from knowarm.reading import read_json
from tests.tiny import flags

FOLDER = Path(__file__).parents[2] / "examples" / "own_algorithm"
NAME = "irb120-bm-a2c"
SMALL = {
    "total_steps": 48,
    "checkpoint_every_steps": 16,
    "env": {"image_size": 20, "dynamics": "kinematic"},
    "algorithm": {"num_envs": 4, "rollout_steps": 4},
    "interim": {"episodes": 2, "every_steps": 32},
}
FAST = ALGORITHMS["fast"]


@pytest.fixture(autouse=True)
def in_its_folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(FOLDER)
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setenv(VARIABLE, "")
    yield
    ALGORITHMS.pop("a2c", None)
    sys.modules.pop("a2c", None)


def test_it_is_trained_and_evaluated_by_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    own = ["--algorithms", "a2c:A2C"]
    options = ["--runs", str(tmp_path), "--algorithm.gamma", "0.9", *flags(SMALL)]
    assert main(["train", NAME, *options]) == 2
    assert "Unknown algorithm of the experiment 'a2c'" in capsys.readouterr().err
    assert main(["train", NAME, *options, *own]) == 0
    run = tmp_path / NAME / "0"
    assert f"knowarm evaluate {run} --algorithms a2c:A2C\n" in capsys.readouterr().out
    assert read_json(run / "config.json")["algorithm"]["gamma"] == 0.9
    assert (
        _parse("train", [NAME]).again
        == f"knowarm train {NAME} --resume --algorithms a2c:A2C"
    )

    ALGORITHMS.pop("a2c")  # as a new process does not know it
    monkeypatch.setenv(VARIABLE, "")
    played = ["evaluate", str(run), "--episodes", "2", "--blind-episodes", "0"]
    assert main(played) == 2
    assert "Read one of your own with `--algorithms package" in capsys.readouterr().err
    assert main([*played, *own]) == 0


def test_a_resumed_training_has_the_bytes_of_an_uninterrupted_one(
    tmp_path: Path,
) -> None:
    register_algorithm("a2c:A2C")
    config = experiment_config(NAME, **SMALL)
    asked: list[None] = []

    def after_two_updates() -> bool:
        asked.append(None)
        return len(asked) > 2

    train(config, tmp_path / "a")
    stopped = train(config, tmp_path / "b", should_stop=after_two_updates)
    assert (stopped.result.reason, stopped.result.step) == ("stopped", 32)
    train(config, tmp_path / "b", resume=True)
    one, other = (
        read_checkpoint(tmp_path / run / NAME / "0" / "checkpoints" / "latest")
        for run in ("a", "b")
    )
    for part in ("policy", "optimizer", "state"):
        arrays, others = getattr(one, part), getattr(other, part)
        assert arrays.keys() == others.keys()
        assert arrays
        for name, array in arrays.items():
            np.testing.assert_array_equal(array, others[name], err_msg=name)


def test_an_attribute_of_its_own_named_best_does_not_collide(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    register_algorithm("a2c:A2C")
    update = sys.modules["a2c"].A2CTrainer.update

    def with_best(self: Any, total_steps: int) -> Any:
        self.best = self.evaluated_step = 0.5
        return update(self, total_steps)

    monkeypatch.setattr(sys.modules["a2c"].A2CTrainer, "update", with_best)
    assert train(experiment_config(NAME, **SMALL), tmp_path).result.reason == "finished"


def test_the_processes_of_a_study_know_what_is_registered_here() -> None:
    register_algorithm("a2c:A2C")
    program = (
        "from knowarm.experiment.algorithms import algorithms; print(*algorithms())"
    )
    words = [sys.executable, "-c", program]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert "a2c" in done.stdout.split()


def test_the_tutorial_shows_parts_of_the_file() -> None:
    page = (FOLDER.parents[1] / "docs/tutorials/own-algorithm.md").read_text("utf-8")
    parts = re.findall(
        r"skip part of the file -->\n\n```python\n(.*?)```", page, re.DOTALL
    )
    assert len(parts) == 3
    for part in parts:
        assert part in (FOLDER / "a2c.py").read_text("utf-8")


def test_the_variable_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "a2c:A2C")
    assert algorithms()["a2c"].about == "advantage actor-critic in one process"
    assert experiment_config(NAME).algorithm == algorithms()["a2c"].config


def test_a_mistyped_field_of_its_policy_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mistyped = dataclasses.replace(FAST, policy={"pixel_shfit": 0.0})
    monkeypatch.setitem(ALGORITHMS, "mine", mistyped)
    with pytest.raises(UserError, match=r"'pixel_shfit'.*Did you mean 'pixel_shift'"):
        experiment_config("irb120-bm-mine")


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("a2c", "is given as package.module:Name, got 'a2c'"),
        ("no_such_module:A2C", "Cannot import the algorithm 'no_such_module:A2C'"),
        (
            "a2c:A2CTrainer",
            "is no algorithm: a2c has another 'A2CTrainer'. Name an instance of",
        ),
        ("a2c:A3C", "a2c has no 'A3C'"),
        ("tests.examples.test_own_algorithm:FAST", "has the name 'ppo', which another"),
    ],
)
def test_what_is_no_algorithm_is_refused_in_one_line(place: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        register_algorithm(place)
