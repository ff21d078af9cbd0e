"""Learner: gradients in one process and in several, and restarts of dead workers."""

import dataclasses
import os
import signal

import numpy as np
import pytest
import torch

from knowarm.cores import available_cores
from knowarm.learn import Hooks, PPOConfig, PPOTrainer
from knowarm.learn.learner import GradientCommand, count_processes
from tests.learn import toys
from tests.learn.toys import SIDE, informed_toy_policy, toy_env

CONFIG = PPOConfig(
    num_envs=32, rollout_steps=6, minibatches=2, matmul_precision="float32", processes=2
)


def noisy_learner(processes, **options):
    return toys.noisy_learner(
        dataclasses.replace(CONFIG, processes=processes), **options
    )


def values(terms):
    return torch.stack([*terms.values()])


def test_gradients_depend_on_the_minibatch_alone():
    learner, results = noisy_learner(1), []
    with learner.running():
        for first in (0, 8, 8):
            terms = learner.compute_gradient(torch.arange(first, first + 8))
            results.append((values(terms), learner.gradient.clone()))
    (_, first), (terms, second), (terms_again, again) = results
    assert not torch.allclose(first, second)
    torch.testing.assert_close(terms, terms_again)
    torch.testing.assert_close(second, again)


@pytest.mark.parametrize("auxiliary", [0, 5])
def test_loss_and_gradient_of_two_processes_are_those_of_one(auxiliary):
    env_ids, results = (
        torch.tensor([5, 3, 31, 8, 0, 12, 9, 30, 2, 4, 6, 7, 1, 11, 10]),
        [],
    )
    for processes in (1, 2):
        learner = noisy_learner(processes, auxiliary=auxiliary)
        with learner.running():
            terms = learner.compute_gradient(env_ids)
            # A second call does not add to the first one's
            learner.compute_gradient(env_ids)
        results.append((values(terms), learner.gradient.clone()))
        assert ("auxiliary_loss" in terms) == bool(auxiliary)
    assert results[0][1].abs().max() > 0
    for one, two in zip(*results, strict=True):
        torch.testing.assert_close(one, two, rtol=1e-4, atol=1e-6)


def test_a_step_of_two_processes_is_that_of_one():
    rng, results = np.random.default_rng(3), []
    image = torch.from_numpy(rng.integers(0, 256, (32, SIDE, SIDE, 3), np.uint8))
    for processes in (1, 2):
        learner = noisy_learner(processes)
        state = learner.rollout.start_h.clone(), learner.rollout.start_c.clone()
        with learner.running():
            logits, state = learner.infer(learner.rollout, 0, image, state)
            again, state = learner.infer(learner.rollout, 1, image, state)
        patches, values = (
            learner.rollout.patches[:2].clone(),
            learner.rollout.value[:2].clone(),
        )
        results.append((patches, values, logits, again, *(s.clone() for s in state)))
    assert not torch.equal(results[0][2], results[0][3])
    for one, two in zip(*results, strict=True):
        torch.testing.assert_close(one, two)


def test_a_killed_worker_is_restarted_and_nothing_is_lost(caplog):
    learner, env_ids = noisy_learner(2), torch.arange(16)
    with learner.running():
        expected = values(learner.compute_gradient(env_ids))
        gradient = learner.gradient.clone()
        os.kill(learner._workers[0].child.process.pid, signal.SIGKILL)
        assert torch.equal(values(learner.compute_gradient(env_ids)), expected)
        assert torch.equal(learner.gradient, gradient)
    assert "learner worker 1 was killed by signal 9; restarting" in caplog.text


def test_a_failing_worker_stops_training_with_its_traceback():
    learner, beyond = noisy_learner(2), GradientCommand(np.array([99]), 0.5)
    message = r"(?s)learner worker 1 failed.*Traceback.*index.*3 times"
    with (
        learner.running(),
        pytest.raises(RuntimeError, match=message),
        learner._executing([beyond]),
    ):
        pass


def test_workers_exit_with_the_context():
    learner = noisy_learner(2)
    with learner.running():
        process = learner._workers[0].child.process
        assert process.is_alive()
    assert not process.is_alive()


@pytest.mark.parametrize(
    ("wanted", "envs", "expected"), [(1, 64, 1), (4, 64, 4), (9, 64, 4), (4, 8, 1)]
)
def test_small_minibatches_limit_the_processes(wanted, envs, expected):
    config = dataclasses.replace(CONFIG, num_envs=envs, processes=wanted)
    assert count_processes(config) == expected


def test_one_process_a_core_by_default():
    config = dataclasses.replace(CONFIG, num_envs=4096, processes=None)
    assert count_processes(config) == available_cores()


def test_two_processes_learn_like_one_and_the_same_way_again():
    def train(processes):
        config = dataclasses.replace(CONFIG, reward_scale=1.0, processes=processes)
        rows, trained = [], informed_toy_policy(4)
        env = toy_env(32, np.ones((3, 4), np.float32), recall=False, length=5)
        hooks = Hooks(on_metrics=rows.append)
        PPOTrainer(config, trained, env, seed=0, hooks=hooks).train(6 * 32 * 3)
        return [row["policy_loss"] for row in rows], trained.state_dict()

    (losses, one), (losses_2, two), (_, again) = train(1), train(2), train(2)
    np.testing.assert_allclose(losses, losses_2, rtol=1e-3, atol=1e-5)
    for name, tensor in two.items():
        assert torch.equal(tensor, again[name])
        torch.testing.assert_close(tensor, one[name], rtol=1e-3, atol=1e-4)
