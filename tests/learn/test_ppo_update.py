"""One update of PPO against plain loops: reward scale, targets, learning rate, gradient limit."""

import dataclasses

import numpy as np
import pytest
import torch

from knowarm.learn.algorithms import PPOConfig
from knowarm.learn.ppo import PPOTrainer
from tests.learn.toys import informed_toy_policy, recorder, toy_env

TABLE = np.random.default_rng(0).standard_normal((4, 6)).astype(np.float32)
CONFIG = PPOConfig(
    num_envs=8,
    rollout_steps=12,
    epochs=1,
    minibatches=2,
    reward_scale=0.25,
    gamma=0.9,
    gae_lambda=0.8,
    matmul_precision="float32",
    processes=1,
)


def build(*, recall=False, hooks=None, **changes):
    env = toy_env(8, TABLE, recall=recall, length=5, staggered=True, facets=4)
    config = dataclasses.replace(CONFIG, **changes)
    return PPOTrainer(
        config, informed_toy_policy(TABLE.shape[1]), env, seed=1, hooks=hooks
    )


def advantages_by_hand(rollout, scale, gamma, gae_lambda):
    """Return the advantages (T, B), one environment and step after the other, in float64."""
    steps, batch = rollout.reward.shape
    values = rollout.value.double().numpy()
    result = np.zeros((steps, batch))
    for b in range(batch):
        carried = 0.0
        for t in reversed(range(steps)):
            ended, cut = bool(rollout.terminated[t, b]), bool(rollout.truncated[t, b])
            after = float(rollout.last_value[b]) if t == steps - 1 else values[t + 1, b]
            if cut:
                after = float(rollout.final_value[t, b])
            if ended:
                after = 0.0
            delta = scale * float(rollout.reward[t, b]) + gamma * after - values[t, b]
            carried = delta + (0.0 if ended or cut else gamma * gae_lambda * carried)
            result[t, b] = carried
    return result


@pytest.mark.parametrize("recall", [False, True])
def test_targets_are_those_of_a_plain_loop(recall):
    """Episodes of one task end by the time limit, those of the other terminate."""
    trainer = build(recall=recall)
    trainer.train(96)
    rollout, targets = trainer._learner.rollout, trainer._learner.targets
    assert rollout.done[:-1].any()
    assert bool(rollout.terminated.any()) == recall
    expected = advantages_by_hand(rollout, 0.25, 0.9, 0.8)
    returns = expected + rollout.value.numpy()
    np.testing.assert_allclose(
        targets["returns"].numpy(), returns, rtol=1e-4, atol=1e-5
    )
    expected = (expected - expected.mean()) / expected.std(ddof=1)
    np.testing.assert_allclose(
        targets["advantage"].numpy(), expected, rtol=1e-3, atol=1e-4
    )


def test_the_scheduled_learning_rate_is_the_optimizers():
    seen = recorder()
    trainer = build(
        hooks=seen.hooks,
        learning_rate=1e-3,
        learning_rate_schedule="linear",
        learning_rate_final=0.0,
    )
    rates = []
    (adam,) = trainer._optimizer._optimizers
    step = adam.step

    def watched():
        rates.append(*[group["lr"] for group in adam.param_groups])
        return step()

    adam.step = watched
    trainer.train(4 * 96)
    expected = [1e-3, 0.75e-3, 0.5e-3, 0.25e-3]
    assert rates == pytest.approx([rate for rate in expected for _ in range(2)])
    assert [row["learning_rate"] for row in seen.rows] == pytest.approx(expected)


def test_the_gradient_is_clipped_to_the_limit():
    trainer = build(max_grad_norm=1e-3)
    norms = []
    step = trainer._optimizer.step

    def watched():
        norms.append(float(torch.linalg.vector_norm(trainer._learner.gradient)))
        return step()

    trainer._optimizer.step = watched
    seen = []
    trainer.hooks = dataclasses.replace(trainer.hooks, on_metrics=seen.append)
    trainer.train(96)
    assert norms == pytest.approx([1e-3] * 2, rel=1e-4)
    assert seen[0]["grad_norm"] > 1e-2  # before clipping
