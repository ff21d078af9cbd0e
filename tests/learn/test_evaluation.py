"""Interim evaluations: the same results inline and in a child process."""

import numpy as np
import pytest

from knowarm.learn import CheckpointStore, PPOConfig, PPOTrainer, read_checkpoint
from knowarm.learn.evaluation import MAX_PENDING, Evaluations
from knowarm.learn.parallel.shared_tensors import flatten_parameters
from tests.learn.toys import toy_env, toy_policy

CONFIG = PPOConfig(
    num_envs=8, rollout_steps=12, minibatches=2, matmul_precision="float32", processes=1
)


def squared_norm(policy):
    return {
        "return_mean": float(
            sum(p.detach().square().sum() for p in policy.parameters())
        )
    }


def make_squared_norm():
    return squared_norm


def exit_process(policy):
    raise SystemExit(3)


def make_exit():
    return exit_process


def fail(policy):
    raise ZeroDivisionError("evaluation")


def make_fail():
    return fail


def take_all(evaluations):
    completed = evaluations.completed(timeout_s=0.0)
    while evaluations.pending():
        completed += evaluations.completed(timeout_s=0.2)
    return completed


@pytest.mark.slow
def test_background_evaluations_equal_inline_ones():
    results = []
    for in_background in (False, True):
        evaluations = Evaluations(
            toy_policy(), make_squared_norm, in_background=in_background
        )
        for step in range(MAX_PENDING + 3):
            evaluations.submit(step, flatten_parameters(toy_policy(seed=step)))
        results.append(take_all(evaluations))
        assert not evaluations.pending()
        evaluations.close()
    assert len(results[0]) == MAX_PENDING + 3
    for inline, background in zip(*results, strict=True):
        assert inline.step == background.step
        assert inline.results == pytest.approx(background.results)
        np.testing.assert_array_equal(inline.values, background.values)


@pytest.mark.slow
def test_training_with_background_evaluations_keeps_the_same_best_policy(
    tmp_path, monkeypatch
):
    best = []
    for in_background in (False, True):
        store = CheckpointStore(tmp_path / str(in_background), {})
        env = toy_env(8, recall=False, length=5, staggered=True)
        options = {
            "make_evaluate": make_squared_norm,
            "evaluate_every": 96,
            "checkpoints": store,
        }
        trainer = PPOTrainer(CONFIG, toy_policy(), env, seed=3, **options)
        monkeypatch.setattr(trainer, "evaluates_in_background", in_background)
        trainer.train(96 * 4)
        best.append(
            (
                trainer._best_step,
                read_checkpoint(store.folder / "best").facts["return_mean"],
            )
        )
    assert best[0] == pytest.approx(best[1])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (make_exit, "The evaluator ended with exit code 3; 3 times in a row"),
        (make_fail, "(?s)The evaluator failed.*ZeroDivisionError: evaluation.*3 times"),
    ],
)
def test_an_evaluator_that_always_fails_stops_training(make, message):
    evaluations = Evaluations(toy_policy(), make, in_background=True)
    evaluations.submit(0, flatten_parameters(toy_policy()))
    with pytest.raises(RuntimeError, match=message):
        take_all(evaluations)
    assert evaluations.process.restarts == 2
    evaluations.close()
