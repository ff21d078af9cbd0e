"""Processes that share the work compute what one alone computes, and none is missed."""

import dataclasses
import os
import signal

import numpy as np
import pytest
import torch

from knowarm.cores import available_cores
from knowarm.learn import Hooks, PPOConfig, PPOTrainer
from knowarm.learn.helper import Learn
from knowarm.learn.learner import count_processes, make_learner
from knowarm.learn.minibatch import differentiate
from knowarm.policy import Policy, PolicyConfig
from tests.learn.toys import JOINTS, LEVELS, SIDE, ToyEnv

TABLE = np.random.default_rng(0).standard_normal((3, 4)).astype(np.float32)
CONFIG = PPOConfig(
    num_envs=32, rollout_steps=6, minibatches=2, matmul_precision="float32", processes=2
)


def policy():
    sizes = {"joints": JOINTS, "levels": LEVELS, "image_size": SIDE, "features": 16}
    return Policy(PolicyConfig(**sizes, knowledge_dim=4, actor_gain=1.0), seed=1)


def team(processes):
    """A team whose rollout and targets hold made-up numbers."""
    config = dataclasses.replace(CONFIG, processes=processes)
    made = make_learner(policy(), config, TABLE, "float32", torch.device("cpu"))
    rng, rollout = np.random.default_rng(2), made.rollout
    rollout.patches.copy_(torch.from_numpy(rng.integers(0, 256, rollout.patches.shape, np.uint8)))
    rollout.facet.copy_(torch.from_numpy(rng.integers(0, 3, rollout.facet.shape)))
    rollout.episode_start.copy_(torch.from_numpy(rng.random(rollout.shape) < 0.2))
    rollout.action.copy_(torch.from_numpy(rng.integers(0, LEVELS, rollout.action.shape)))
    floats = (rollout.log_probability, rollout.start_h, rollout.start_c)
    for tensor in (*floats, made.targets.advantage, made.targets.returns):
        tensor.copy_(torch.from_numpy(rng.standard_normal(tensor.shape)))
    return made


def test_loss_and_gradient_of_two_processes_are_those_of_one():
    columns, results = torch.tensor([5, 3, 31, 8, 0, 12, 9, 30, 2, 4, 6, 7, 1, 11, 10]), []
    for processes in (1, 2):
        made = team(processes)
        with made.at_work():
            terms = made.differentiate(columns)
            made.differentiate(columns)  # a second call does not add to the first one's
        results.append((terms.vector(), made.gradient.clone()))
    assert results[0][1].abs().max() > 0
    for one, two in zip(*results, strict=True):
        torch.testing.assert_close(one, two, rtol=1e-4, atol=1e-6)


def test_the_helpers_part_counts():
    made, columns = team(2), torch.arange(16)
    with made.at_work():
        made.differentiate(columns)
    whole = made.gradient.clone()
    made.gradient.zero_()
    table = torch.from_numpy(TABLE)
    differentiate(made.policy, CONFIG, table, made.rollout, made.targets, columns[:8], 0.5)
    assert not torch.allclose(whole, made.gradient, rtol=1e-2, atol=1e-4)


def test_a_step_of_two_processes_is_that_of_one():
    rng, results = np.random.default_rng(3), []
    image = torch.from_numpy(rng.integers(0, 256, (32, SIDE, SIDE, 3), np.uint8))
    for processes in (1, 2):
        made = team(processes)
        state = made.rollout.start_h.clone(), made.rollout.start_c.clone()
        with made.at_work():
            logits, state = made.play(made.rollout, 0, image, state)
            again, state = made.play(made.rollout, 1, image, state)
        patches, values = made.rollout.patches[:2].clone(), made.rollout.value[:2].clone()
        results.append((patches, values, logits, again, *(s.clone() for s in state)))
    assert not torch.equal(results[0][2], results[0][3])
    for one, two in zip(*results, strict=True):
        torch.testing.assert_close(one, two)


def test_a_killed_helper_is_replaced_and_nothing_is_lost(caplog):
    made, columns = team(2), torch.arange(16)
    with made.at_work():
        expected = made.differentiate(columns).vector()
        gradient = made.gradient.clone()
        os.kill(made._helpers[0].process.pid, signal.SIGKILL)
        assert torch.equal(made.differentiate(columns).vector(), expected)
        assert torch.equal(made.gradient, gradient)
    assert "learning helper 1 was killed by signal 9" in caplog.text


def test_a_failing_helper_stops_training_with_its_traceback():
    made, beyond = team(2), Learn(np.array([99]), 0.5)
    with made.at_work():
        made._send([beyond])
        with pytest.raises(RuntimeError, match=r"(?s)learning helper 1 failed.*Traceback.*index"):
            made._await([beyond])


def test_helpers_are_gone_when_the_work_is_done():
    made = team(2)
    with made.at_work():
        process = made._helpers[0].process
        assert process.is_alive()
    assert not process.is_alive()


@pytest.mark.parametrize(
    ("wanted", "envs", "expected"), [(1, 64, 1), (4, 64, 4), (9, 64, 4), (4, 8, 1)]
)
def test_no_more_processes_than_are_worth_it(wanted, envs, expected):
    config = dataclasses.replace(CONFIG, num_envs=envs, processes=wanted)
    assert count_processes(config) == expected


def test_one_process_a_core_by_default():
    config = dataclasses.replace(CONFIG, num_envs=4096, processes=None)
    assert count_processes(config) == available_cores()


def test_two_processes_learn_like_one_and_the_same_way_again():
    def train(processes):
        config = dataclasses.replace(CONFIG, reward_scale=1.0, processes=processes)
        rows, trained = [], policy()
        env = ToyEnv(32, recall=False, length=5)
        hooks = Hooks(on_metrics=rows.append)
        PPOTrainer(config, trained, env, TABLE, seed=0, hooks=hooks).train(6 * 32 * 3)
        return [row["policy_loss"] for row in rows], trained.state_dict()

    (losses, one), (losses_2, two), (_, again) = train(1), train(2), train(2)
    np.testing.assert_allclose(losses, losses_2, rtol=1e-3, atol=1e-5)
    for name, tensor in two.items():
        assert torch.equal(tensor, again[name])
        torch.testing.assert_close(tensor, one[name], rtol=1e-3, atol=1e-4)
