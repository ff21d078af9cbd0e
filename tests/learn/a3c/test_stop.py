"""Stopping A3C, whatever its evaluations take, and processes that were stopped from outside."""

import dataclasses
import os
import signal
import time
from functools import partial
from pathlib import Path

import pytest

from knowarm.learn import Hooks, NumpyToTorch
from knowarm.learn.a3c import A3CTrainer
from knowarm.learn.a3c.worker_pool import WorkerPool
from knowarm.learn.checkpoint import CheckpointStore
from knowarm.learn.evaluation import MAX_PENDING
from tests.learn.a3c.test_trainer import FAST, Make
from tests.learn.toys import ToyEnv, toy_policy

UPDATE = 96
INTERVAL = 10 * UPDATE


@dataclasses.dataclass(frozen=True)
class Paced:
    """Environments whose updates take at least 60 ms, so that the trainer keeps up anywhere."""

    def __call__(self, num_envs, num_threads):
        env = ToyEnv(num_envs, recall=False, length=5)
        step = env.step

        def paced_step(actions):
            time.sleep(0.01)
            return step(actions)

        env.step = paced_step
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


def build(gate, checkpoints, *, workers=1, make_env=None, evaluate_every=UPDATE, **hooks):
    evaluations = []
    trainer = A3CTrainer(
        dataclasses.replace(FAST, workers=workers),
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
def test_checkpoints_do_not_wait_for_evaluations(tmp_path, workers):
    """The evaluator never answers, and every interval is saved all the same."""
    store = StepsOfCheckpoints()
    trainer, evaluations = build(
        tmp_path / "never",
        store,
        workers=workers,
        make_env=Paced(),
        evaluate_every=INTERVAL,
        should_stop=lambda: trainer.step >= 6 * INTERVAL,
    )
    assert trainer.train(10**9).reason == "stopped"
    assert evaluations == []
    gaps = [b - a for a, b in zip(store.steps, store.steps[1:], strict=False)]
    assert max(gaps) <= 2 * INTERVAL
    assert trainer.step - store.steps[-1] <= workers * UPDATE


@pytest.mark.slow
def test_a_stop_saves_pending_evaluations_and_resuming_plays_them(tmp_path):
    store = CheckpointStore(tmp_path, {})
    gate = tmp_path / "gate"
    trainer, evaluations = build(gate, store, should_stop=lambda: trainer.step >= 4 * UPDATE)
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
        tmp_path / "never", CheckpointStore(tmp_path, {}), should_stop=lambda: trainer._paused
    )
    assert trainer.train(10**9).reason == "stopped"
    pending = [name for name in trainer.checkpoints.load().state if name.startswith("pending")]
    assert len(pending) > MAX_PENDING


@pytest.mark.slow
def test_the_last_evaluations_can_be_interrupted(tmp_path):
    trained = []
    trainer, evaluations = build(
        tmp_path / "never",
        CheckpointStore(tmp_path, {}),
        should_stop=lambda: trained.append(trainer.step) or trained.count(2 * UPDATE) > 10,
    )
    assert trainer.train(2 * UPDATE).reason == "stopped"
    assert evaluations == []
    assert trainer.checkpoints.load().facts["step"] == 2 * UPDATE


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="Windows has no SIGSTOP")
@pytest.mark.parametrize("which", ["worker", "evaluator"])
def test_a_stopped_process_is_continued(tmp_path, which):
    stopped = []

    def stop(row):
        children = {"worker": trainer._pool.workers[1], "evaluator": trainer._evaluations._child}
        if not stopped:
            stopped.append(children[which].process.pid)
            os.kill(stopped[0], signal.SIGSTOP)

    gate = tmp_path / "gate"
    gate.touch()
    trainer, evaluations = build(
        gate, CheckpointStore(tmp_path, {}), workers=2, evaluate_every=INTERVAL, on_metrics=stop
    )
    assert trainer.train(3 * INTERVAL).reason == "finished"
    assert stopped
    assert trainer.restarts == trainer._evaluations.restarts == 0
    assert [step // INTERVAL for step, *_ in evaluations][:4] == [0, 1, 2, 3]


@pytest.mark.slow
def test_a_worker_that_never_answers_does_not_block_a_stop(tmp_path, monkeypatch, caplog):
    trainer, _ = build(
        tmp_path / "never",
        CheckpointStore(tmp_path, {}),
        workers=2,
        should_stop=lambda: trainer.step >= 2 * UPDATE,
    )
    monkeypatch.setattr("knowarm.learn.a3c.trainer.STATE_S", 0.0)
    monkeypatch.setattr(WorkerPool, "read", lambda pool, timeout_s: iter(()))
    trainer.step = 2 * UPDATE
    assert trainer.train(10**9).reason == "stopped"
    assert "No state arrived from the workers [0, 1]" in caplog.text
    assert trainer.checkpoints.load().facts["step"] == int(trainer._shared["steps"].sum())
