"""A3C's loss and rollouts by hand: value weight, time limit, rollouts that end with episodes."""

import pytest
import torch

from knowarm.errors import UserError
from knowarm.learn.a3c.update import rollout_loss
from knowarm.learn.algorithms import A3CConfig
from knowarm.learn.losses import a3c_loss
from knowarm.learn.rollout import Collector, Rollout
from tests.learn.toys import toy_env, toy_policy


def collected(steps=8, *, count=1, until_episode_end=True):
    """Collect a rollout of episodes that are truncated after 5 steps."""
    policy, env = toy_policy(features=8), toy_env(count, recall=False, length=5)
    collector = Collector(env, policy, seed=0)
    rollout = Rollout.zeros(steps, count, policy)
    taken = [
        collector.collect(rollout, until_episode_end=until_episode_end)
        for _ in range(2)
    ]
    return policy, rollout.first(taken[-1]), taken


def test_half_the_squared_error_enters_with_the_papers_weight_1():
    config = A3CConfig()
    terms = a3c_loss(
        torch.zeros(1, 1, 2),
        torch.tensor([1.0]),
        torch.tensor([[0]]),
        torch.tensor([0.0]),
        torch.tensor([4.0]),
        vf_coef=config.vf_coef,
        ent_coef=0.0,
    )
    assert terms["total"].item() == pytest.approx(0.5 * (4 - 1) ** 2)


def test_a_rollout_ends_with_its_episode():
    _, rollout, taken = collected()
    assert taken == [5, 5]
    assert rollout.reward.shape == (5, 1)
    assert rollout.truncated[:, 0].tolist() == [False] * 4 + [True]
    assert rollout.episode_start[:, 0].tolist() == [True] + [False] * 4
    assert rollout.start_h.shape == (1, 8)
    # An episode that is longer than a rollout continues in the next one.
    _, rollout, taken = collected(3)
    assert taken == [3, 2]
    assert rollout.start_h.abs().sum() > 0
    # Otherwise a rollout spans the end of an episode.
    assert collected(8, until_episode_end=False)[2] == [8, 8]


@pytest.mark.parametrize("bootstrap", [False, True])
def test_the_return_of_a_truncated_episode(bootstrap):
    policy, rollout, _ = collected()
    config = A3CConfig(bootstrap_at_time_limit=bootstrap, gamma=0.5, ent_coef=0.0)
    assert float(rollout.final_value[-1]) != 0
    future = float(rollout.final_value[-1]) if bootstrap else 0.0
    returns = []
    for reward in reversed(rollout.reward[:, 0].tolist()):
        future = reward + 0.5 * future
        returns.insert(0, future)
    error = torch.tensor(returns) - rollout.value[:, 0]
    loss = rollout_loss(policy, config, rollout)
    assert loss["value_loss"].item() == pytest.approx(
        0.5 * float(error.square().mean()), rel=1e-5
    )
    policy_loss = -(rollout.log_probability[:, 0] * error).mean()
    assert loss["policy_loss"].item() == pytest.approx(float(policy_loss), rel=1e-4)
    assert loss["total"].item() == pytest.approx(
        loss["policy_loss"].item() + loss["value_loss"].item(), rel=1e-5
    )


def test_rollouts_of_several_environments_cannot_end_with_an_episode():
    several = {"envs_per_worker": 4}
    with pytest.raises(UserError, match="envs_per_worker is 4, and rollout_ends"):
        A3CConfig(**several)
    assert A3CConfig(**several, rollout_ends_with_episode=False).envs_per_worker == 4
    with pytest.raises(
        UserError, match="envs_per_worker is 4, and workers on the fixed"
    ):
        A3CConfig(schedule="fixed", **several, rollout_ends_with_episode=False)
