import dataclasses
import logging
import os
import signal
import subprocess
import sys
import time
from functools import partial

import numpy as np
import psutil
import pytest
import torch

from knowarm.errors import UserError
from knowarm.learn import Hooks, NumpyToTorch
from knowarm.learn.a3c import A3CTrainer
from knowarm.learn.algorithms import A3CConfig
from knowarm.learn.checkpoint import CheckpointStore
from knowarm.learn.guards import NotFiniteError
from tests.learn.toys import (
    ToyEnv,
    informed_toy_policy,
    success_rate,
    toy_policy,
)

FAST = A3CConfig(
    workers=2,
    envs_per_worker=16,
    rollout_steps=6,
    rollout_ends_with_episode=False,
    bootstrap_at_time_limit=True,
    vf_coef=0.5,
    rmsprop_eps=1e-5,
    learning_rate=3e-3,
    gamma=0.5,
    gae_lambda=1.0,
    log_every_steps=960,
)


@dataclasses.dataclass(frozen=True)
class Make:
    """Environments for the workers.

    ``poison`` makes every reward NaN, ``thresholds`` gives them thresholds to multiply.
    """

    recall: bool
    length: int
    poison: bool = False
    thresholds: bool = False

    def __call__(self, num_envs, num_threads):
        assert num_threads == 1
        env = ToyEnv(num_envs, recall=self.recall, length=self.length)
        if self.poison:
            step = env.step
            env.step = lambda actions: (
                *step(actions)[:1],
                np.full(num_envs, np.nan),
                *step(actions)[2:],
            )
        adapted = NumpyToTorch(env)
        if self.thresholds:
            adapted.env.threshold_factor = 1.0
            adapted.step = partial(succeed, adapted.step)
        return adapted


def succeed(step, actions):
    """Take a step in which all episodes that end succeed."""
    *results, infos = step(actions)
    infos["final_info"] = {"is_success": torch.ones(len(actions), dtype=torch.bool)}
    return *results, infos


def make_play(recall, length):
    def play(policy):
        return {
            "return_mean": float(success_rate(policy, recall=recall, length=length))
        }

    return play


SOLVED = 0.75
"""Workers update in another order each time, so the last few per cent come and go (.91 was seen). A
policy that does not look, or does not remember, is right in a third of the episodes at most."""


@pytest.mark.slow
def test_identity_task_is_solved():
    policy = toy_policy()
    # Gradients of the other worker may be old on a busy machine: small steps.
    config = dataclasses.replace(FAST, learning_rate=1e-3)
    A3CTrainer(config, policy, Make(False, 5), seed=0).train(40_000)
    assert success_rate(policy, recall=False, length=5) > SOLVED


@pytest.mark.slow
def test_memory_task_is_solved():
    policy = toy_policy()
    # One worker repeats to the byte.
    config = dataclasses.replace(FAST, gamma=0.99, learning_rate=2e-3, workers=1)
    A3CTrainer(config, policy, Make(True, 3), seed=0).train(45_000)
    assert success_rate(policy, recall=True, length=3) > SOLVED


def test_updates_of_both_workers_arrive_and_are_recorded():
    rows = []
    policy = toy_policy()
    trainer = A3CTrainer(
        FAST, policy, Make(False, 5), seed=0, hooks=Hooks(on_metrics=rows.append)
    )
    before = trainer._shared.copy("values")
    result = trainer.train(5_000)
    assert result.step >= 5_000
    assert trainer._shared["steps"].sum() == result.step
    assert (trainer._shared["steps"] % 96 == 0).all()
    assert not np.array_equal(before, trainer._shared.copy("values"))
    assert rows[-1]["worker_0_steps"] > 0
    assert rows[-1]["worker_1_steps"] > 0
    assert all(row["updates_per_s"] > 0 for row in rows)


def trained(**changes):
    policy, rows = toy_policy(), []
    config = dataclasses.replace(FAST, workers=1, log_every_steps=96, **changes)
    A3CTrainer(
        config, policy, Make(False, 5), seed=0, hooks=Hooks(on_metrics=rows.append)
    ).train(288)
    assert [row["threshold_factor"] for row in rows] == [1, 1, 1]
    return [parameter.detach().numpy().tobytes() for parameter in policy.parameters()]


def test_the_learning_rate_follows_its_schedule():
    constant = trained(learning_rate_schedule="constant")
    assert trained(learning_rate_schedule="linear", learning_rate_final=1.0) == constant
    assert trained(learning_rate_schedule="linear", learning_rate_final=0.0) != constant


@pytest.mark.slow
def test_a_worker_that_always_fails_stops_the_training():
    with pytest.raises(
        RuntimeError, match=r"(?s)The worker \d failed.*takes 2 positional.*3 times"
    ):
        A3CTrainer(FAST, toy_policy(), partial(ToyEnv), seed=0).train(1000)


def test_a_nan_in_a_worker_stops_the_training_and_names_the_term(tmp_path):
    trainer = A3CTrainer(
        FAST, toy_policy(), Make(False, 5, poison=True), seed=0, failure_folder=tmp_path
    )
    before = trainer._shared.copy("values")
    with pytest.raises(NotFiniteError, match="the reward"):
        trainer.train(1000)
    assert list(tmp_path.glob("not-finite-*.safetensors"))
    np.testing.assert_array_equal(trainer._shared.copy("values"), before)


def test_a_user_error_in_a_worker_is_raised_as_one():
    policy = informed_toy_policy(4)
    with pytest.raises(UserError, match="expects vectors of 4 float32 numbers"):
        A3CTrainer(FAST, policy, Make(False, 5), seed=0).train(1000)


def build(folder, **hooks):
    rows, evaluations = [], []
    policy = toy_policy()
    trainer = A3CTrainer(
        dataclasses.replace(FAST, workers=1),
        policy,
        Make(True, 7),
        seed=3,
        make_evaluate=partial(make_play, True, 7),
        evaluate_every=1000,
        hooks=Hooks(
            on_metrics=rows.append,
            on_evaluation=lambda *result: evaluations.append(result),
            **hooks,
        ),
        checkpoints=CheckpointStore(folder, {"policy": "small"}),
        checkpoint_every=1500,
    )
    return trainer, rows, evaluations


TIMING = {"wall_time_s", "steps_per_s", "updates_per_s"}


def untimed(rows):
    return [{k: v for k, v in row.items() if k not in TIMING} for row in rows]


@pytest.mark.slow
def test_one_worker_stopped_and_resumed_equals_an_uninterrupted_one_to_the_byte(
    tmp_path,
):
    whole, rows, evaluations = build(tmp_path / "whole")
    whole.train(6000)
    stopped, first, seen = build(tmp_path / "cut", should_stop=lambda: len(first) >= 2)
    assert stopped.train(6000).reason == "stopped"
    assert 1920 <= stopped.step < 6000
    resumed, second, seen_later = build(tmp_path / "cut")
    resumed.resume()
    resumed.train(6000)
    assert untimed(first + second) == untimed(rows)
    assert seen + seen_later == evaluations
    assert [step // 1000 for step, *_ in evaluations] == [0, 1, 2, 3, 4, 5, 6]
    for file in ("policy", "optimizer", "state"):
        name = f"latest/{file}.safetensors"
        assert (tmp_path / "whole" / name).read_bytes() == (
            tmp_path / "cut" / name
        ).read_bytes()


SCRIPT = """
from pathlib import Path
from tests.learn.a3c.test_trainer import build

if __name__ == "__main__":
    trainer, rows, _ = build(Path(__import__("sys").argv[1]))
    trainer.train(10**9)
"""


@pytest.mark.slow
def test_killing_the_trainer_leaves_a_checkpoint_and_no_orphans(tmp_path):
    script = tmp_path / "train.py"
    script.write_text(SCRIPT)
    process = subprocess.Popen(
        [sys.executable, script, tmp_path / "run"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    while not all((tmp_path / "run" / name).exists() for name in ("previous", "best")):
        assert process.poll() is None
        time.sleep(0.1)
    family = psutil.Process(process.pid).children(recursive=True)
    assert len(family) >= 3  # fork server, worker, evaluator
    process.kill()
    process.wait()
    _, alive = psutil.wait_procs(family, timeout=60)
    assert not alive
    trainer, _, _ = build(tmp_path / "run")
    trainer.resume()
    step = trainer.step
    assert step >= 1500
    result = trainer.train(step + 2000)
    assert result.step >= step + 2000


@pytest.mark.slow
def test_a_killed_worker_is_replaced_and_continues_the_curriculum(caplog):
    factors, killed = [], []

    def kill(row):
        factors.append(row["threshold_factor"])
        if len(factors) == 10:
            killed.append(trainer._workers[0].child.process.pid)
            os.kill(killed[0], signal.SIGKILL)

    config = dataclasses.replace(
        FAST, workers=1, log_every_steps=96, threshold_factor=3.0
    )
    trainer = A3CTrainer(
        config,
        toy_policy(),
        Make(False, 5, thresholds=True),
        seed=0,
        hooks=Hooks(on_metrics=kill),
    )
    with caplog.at_level(logging.WARNING, "knowarm.learn"):
        assert trainer.train(3000).reason == "finished"
    assert trainer.restarts == 1
    assert "The worker 0 was killed by signal 9; restarting it" in caplog.text
    assert not psutil.pid_exists(killed[0])
    # After the first update, in which all succeeded
    assert factors[0] == pytest.approx(2.98)
    assert factors == sorted(factors, reverse=True)
