"""Data-parallel learner: same results as in one process, and restarts of dead workers."""

import dataclasses
import os
import signal

import numpy as np
import pytest
import torch

from knowarm.cores import available_cores
from knowarm.learn import Hooks, PPOConfig, PPOTrainer
from knowarm.learn.learner import GradientCommand, count_processes, make_learner
from knowarm.learn.rollout import TrainingNetwork, add_gradient
from tests.learn.toys import SIDE, fill_with_noise, informed_toy_policy, toy_env

TABLE = np.random.default_rng(0).standard_normal((3, 4)).astype(np.float32)
CONFIG = PPOConfig(
    num_envs=32, rollout_steps=6, minibatches=2, matmul_precision="float32", processes=2
)


def policy():
    return informed_toy_policy(TABLE)


def noisy_learner(processes):
    """Create a learner whose rollout and targets hold learner-up numbers."""
    config = dataclasses.replace(CONFIG, processes=processes)
    learner = make_learner(TrainingNetwork(policy(), 0), config, "float32", torch.device("cpu"))
    fill_with_noise(learner, facets=3)
    return learner


def test_loss_and_gradient_of_two_processes_are_those_of_one():
    env_ids, results = torch.tensor([5, 3, 31, 8, 0, 12, 9, 30, 2, 4, 6, 7, 1, 11, 10]), []
    for processes in (1, 2):
        learner = noisy_learner(processes)
        with learner.running():
            terms = learner.compute_gradient(env_ids)
            learner.compute_gradient(env_ids)  # a second call does not add to the first one's
        results.append((terms.vector(), learner.gradient.clone()))
    assert results[0][1].abs().max() > 0
    for one, two in zip(*results, strict=True):
        torch.testing.assert_close(one, two, rtol=1e-4, atol=1e-6)


def test_the_workers_part_counts():
    learner, env_ids = noisy_learner(2), torch.arange(16)
    with learner.running():
        learner.compute_gradient(env_ids)
    whole = learner.gradient.clone()
    learner.gradient.zero_()
    add_gradient(learner.network, CONFIG, learner.rollout, learner.targets, env_ids[:8], 0.5)
    assert not torch.allclose(whole, learner.gradient, rtol=1e-2, atol=1e-4)


def test_a_step_of_two_processes_is_that_of_one():
    rng, results = np.random.default_rng(3), []
    image = torch.from_numpy(rng.integers(0, 256, (32, SIDE, SIDE, 3), np.uint8))
    for processes in (1, 2):
        learner = noisy_learner(processes)
        state = learner.rollout.start_h.clone(), learner.rollout.start_c.clone()
        with learner.running():
            logits, state = learner.infer(learner.rollout, 0, image, state)
            again, state = learner.infer(learner.rollout, 1, image, state)
        patches, values = learner.rollout.patches[:2].clone(), learner.rollout.value[:2].clone()
        results.append((patches, values, logits, again, *(s.clone() for s in state)))
    assert not torch.equal(results[0][2], results[0][3])
    for one, two in zip(*results, strict=True):
        torch.testing.assert_close(one, two)


def test_a_killed_worker_is_restarted_and_nothing_is_lost(caplog):
    learner, env_ids = noisy_learner(2), torch.arange(16)
    with learner.running():
        expected = learner.compute_gradient(env_ids).vector()
        gradient = learner.gradient.clone()
        os.kill(learner._workers[0].child.process.pid, signal.SIGKILL)
        assert torch.equal(learner.compute_gradient(env_ids).vector(), expected)
        assert torch.equal(learner.gradient, gradient)
    assert "learner worker 1 was killed by signal 9; restarting" in caplog.text


def test_a_failing_worker_stops_training_with_its_traceback():
    learner, beyond = noisy_learner(2), GradientCommand(np.array([99]), 0.5)
    with learner.running():
        learner._send([beyond])
        with pytest.raises(
            RuntimeError, match=r"(?s)learner worker 1 failed.*Traceback.*index.*3 times"
        ):
            learner._wait([beyond])


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
        rows, trained = [], policy()
        env = toy_env(32, recall=False, length=5)
        hooks = Hooks(on_metrics=rows.append)
        PPOTrainer(config, trained, env, seed=0, hooks=hooks).train(6 * 32 * 3)
        return [row["policy_loss"] for row in rows], trained.state_dict()

    (losses, one), (losses_2, two), (_, again) = train(1), train(2), train(2)
    np.testing.assert_allclose(losses, losses_2, rtol=1e-3, atol=1e-5)
    for name, tensor in two.items():
        assert torch.equal(tensor, again[name])
        torch.testing.assert_close(tensor, one[name], rtol=1e-3, atol=1e-4)
