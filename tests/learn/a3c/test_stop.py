"""Stopping A3C, whatever its evaluations take."""

import dataclasses
import itertools
import threading
import time
from functools import partial
from pathlib import Path

import pytest

from knowarm.learn import Hooks, NumpyToTorch
from knowarm.learn.a3c import A3CTrainer
from knowarm.learn.checkpoint import CheckpointStore
from knowarm.learn.evaluation import MAX_PENDING
from knowarm.learn.parallel.processes import ChildProcess
from tests.learn.a3c.test_trainer import FAST, Make
from tests.learn.toys import ToyEnv, toy_policy

UPDATE = 96
INTERVAL = 10 * UPDATE


@dataclasses.dataclass(frozen=True)
class InStep:
    """Environments of workers that wait for each other and for the trainer after every update.

    A worker ends an update once the trainer has read the one before of every worker from the file
    ``progress``. So "one update" means the same on every machine.
    """

    progress: Path

    def __call__(self, num_envs, num_threads):
        env = ToyEnv(num_envs, recall=False, length=5)
        step, taken = env.step, itertools.count()

        def step_in_step(actions):
            update, rest = divmod(next(taken), FAST.rollout_steps)
            while (
                rest == FAST.rollout_steps - 1
                and int(self.progress.read_text() or 0) < update
            ):
                time.sleep(0.001)
            return step(actions)

        env.step = step_in_step
        return NumpyToTorch(env)


def make_waiting(gate: Path):
    """Create an evaluation that ends once the file ``gate`` exists."""

    def play(policy):
        while not gate.exists():
            time.sleep(0.01)
        return {"return_mean": 1.0}

    return play


class StepsOfCheckpoints(CheckpointStore):
    """Records the steps of checkpoints, without the time that a disk takes."""

    def __init__(self):
        self.steps = [0]

    def save(self, checkpoint):
        self.steps.append(checkpoint.facts["step"])


def build(
    gate,
    checkpoints,
    *,
    workers=1,
    make_env=None,
    evaluate_every=UPDATE,
    log_every_steps=FAST.log_every_steps,
    **hooks,
):
    evaluations = []
    trainer = A3CTrainer(
        dataclasses.replace(FAST, workers=workers, log_every_steps=log_every_steps),
        toy_policy(features=8),
        make_env or Make(False, 5),
        seed=3,
        make_evaluate=partial(make_waiting, gate),
        evaluate_every=evaluate_every,
        hooks=Hooks(on_evaluation=lambda *result: evaluations.append(result), **hooks),
        checkpoints=checkpoints,
        checkpoint_every=INTERVAL,
    )
    return trainer, evaluations


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_a_checkpoint_is_at_most_one_interval_and_one_update_old(tmp_path, workers):
    """The evaluator never answers, and every interval is saved all the same."""
    store, ages, moved = StepsOfCheckpoints(), [], [(0, time.monotonic())]
    progress = tmp_path / "progress"
    progress.write_text("0")

    def should_stop():
        steps = [trainer._worker_steps[worker] for worker in range(workers)]
        progress.write_text(str(min(steps) // UPDATE))
        if trainer.step > moved[-1][0]:
            moved.append((trainer.step, time.monotonic()))
        is_stuck = time.monotonic() > moved[-1][1] + 300
        return is_stuck or trainer.step >= 6 * INTERVAL

    trainer, evaluations = build(
        tmp_path / "never",
        store,
        workers=workers,
        make_env=InStep(progress),
        evaluate_every=INTERVAL,
        log_every_steps=UPDATE,
        on_metrics=lambda row: ages.append(row["step"] - store.steps[-1]),
        should_stop=should_stop,
    )
    assert trainer.train(10**9).reason == "stopped"
    assert evaluations == []
    assert trainer.step >= 6 * INTERVAL
    assert max(ages) <= INTERVAL + workers * UPDATE
    assert trainer.step - store.steps[-1] <= workers * UPDATE


@pytest.mark.slow
def test_a_stop_saves_pending_evaluations_and_resuming_plays_them(tmp_path):
    store = CheckpointStore(tmp_path, {})
    gate = tmp_path / "gate"
    trainer, evaluations = build(
        gate, store, should_stop=lambda: trainer.step >= 4 * UPDATE
    )
    assert trainer.train(8 * UPDATE).reason == "stopped"
    assert evaluations == []
    stopped_at = trainer.step
    resumed, evaluations = build(gate, store)
    resumed.resume()
    gate.touch()
    assert sorted(resumed.pending_evaluations) == [
        UPDATE * i for i in range(stopped_at // UPDATE + 1)
    ]
    assert resumed.train(8 * UPDATE).reason == "finished"
    assert [step for step, *_ in evaluations] == [UPDATE * i for i in range(9)]
    assert not any(name.startswith("pending") for name in store.load().state)


@pytest.mark.slow
def test_training_pauses_when_the_evaluator_is_far_behind_and_can_be_stopped(tmp_path):
    trainer, _ = build(
        tmp_path / "never",
        CheckpointStore(tmp_path, {}),
        should_stop=lambda: bool(trainer._shared["paused"]),
    )
    assert trainer.train(10**9).reason == "stopped"
    pending = [
        name for name in trainer.checkpoints.load().state if name.startswith("pending")
    ]
    assert len(pending) > MAX_PENDING


@pytest.mark.slow
def test_the_last_evaluations_can_be_interrupted(tmp_path):
    trained = []
    trainer, evaluations = build(
        tmp_path / "never",
        CheckpointStore(tmp_path, {}),
        should_stop=lambda: (
            trained.append(trainer.step) or trained.count(2 * UPDATE) > 10
        ),
    )
    assert trainer.train(2 * UPDATE).reason == "stopped"
    assert evaluations == []
    assert trainer.checkpoints.load().facts["step"] == 2 * UPDATE


@pytest.mark.slow
def test_a_worker_that_never_answers_does_not_block_a_stop(
    tmp_path, monkeypatch, caplog
):
    reads = []
    trainer, _ = build(
        tmp_path / "never",
        CheckpointStore(tmp_path, {}),
        workers=2,
        should_stop=lambda: len(reads) > 0,
    )
    monkeypatch.setattr("knowarm.learn.a3c.trainer.STATE_S", 0.0)
    monkeypatch.setattr(
        A3CTrainer, "_read_worker", lambda trainer, index: reads.append(0)
    )
    assert trainer.train(10**9).reason == "stopped"
    assert "No state arrived from the workers [0, 1]" in caplog.text
    assert trainer.checkpoints.load().facts["step"] == int(
        trainer._shared["steps"].sum()
    )
    # Resumed workers without a state must not repeat random numbers from which they have learned.
    learned = [int(steps > 0) for steps in trainer._shared["steps"]]
    assert trainer.checkpoints.load().facts["restarts"] == learned


@dataclasses.dataclass(frozen=True)
class Busy:
    """Environments whose first step never ends."""

    def __call__(self, num_envs, num_threads):
        env = ToyEnv(num_envs, recall=False, length=5)
        env.step = lambda actions: threading.Event().wait()
        return NumpyToTorch(env)


def test_a_stop_kills_busy_processes_at_once(tmp_path, monkeypatch):
    """The time until they would be killed would add to the one that the workers have to answer."""
    timeouts, asked, stop = [], [], ChildProcess.stop
    monkeypatch.setattr("knowarm.learn.a3c.trainer.STATE_S", 0.1)
    monkeypatch.setattr(
        ChildProcess,
        "stop",
        lambda child, timeout_s=99.0: timeouts.append(timeout_s) or stop(child, 0),
    )
    trainer, _ = build(
        tmp_path / "never",
        CheckpointStore(tmp_path, {}),
        workers=2,
        make_env=Busy(),
        should_stop=lambda: asked.append(0) or len(asked) > 6,
    )
    assert trainer.train(10**9).reason == "stopped"
    assert timeouts == [0.0] * 3  # two workers and the evaluator
    assert trainer.checkpoints.load().facts["step"] == 0
    assert trainer.checkpoints.load().facts["restarts"] == [0, 0]
