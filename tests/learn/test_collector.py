"""Rollouts: contents, continuation, and the two ways to value final observations."""

import numpy as np
import pytest
import torch

from knowarm.errors import UserError
from knowarm.learn.collector import Collector, DeferredFinalValues
from knowarm.learn.rollout import Rollout, rollout_specs
from knowarm.learn.shared_tensors import zeros
from tests.learn.toys import informed_toy_policy, toy_env, toy_policy

COUNT, STEPS = 8, 12


def collect(rollouts, *, deferred, recall, length):
    """Collect some rollouts with an untrained policy; return collector and copies of them."""
    policy, env = (
        toy_policy(features=16),
        toy_env(COUNT, recall=recall, length=length, staggered=True),
    )
    env.max_episode_steps = length
    final_values = DeferredFinalValues(policy, env) if deferred else None
    collector = Collector(env, policy, seed=3, final_values=final_values)
    rollout = Rollout(**zeros(rollout_specs(STEPS, COUNT, policy)))
    collected = []
    for _ in range(rollouts):
        collector.collect(rollout)
        collected.append({name: tensor.clone() for name, tensor in rollout.tensors().items()})
    return collector, collected


@pytest.mark.parametrize("recall", [False, True])
@pytest.mark.parametrize("length", [5, 12, 20])
def test_final_observations_have_the_same_values_now_and_later(recall, length):
    (_, now), (_, later) = (
        collect(3, deferred=deferred, recall=recall, length=length) for deferred in (False, True)
    )
    for one, other in zip(now, later, strict=True):
        for name, tensor in one.items():
            # Values of final observations are computed in other batches, which round differently.
            tolerance = 1e-6 if name == "final_value" else 0.0
            torch.testing.assert_close(tensor, other[name], rtol=0, atol=tolerance)


@pytest.mark.parametrize("deferred", [False, True])
def test_every_truncated_step_and_no_other_has_a_final_value(deferred):
    _, rollouts = collect(2, deferred=deferred, recall=False, length=5)
    for rollout in rollouts:
        assert torch.equal(rollout["final_value"] != 0, rollout["truncated"])
        assert rollout["truncated"].sum() > COUNT


def test_a_rollout_holds_what_the_policy_computed():
    policy, env = toy_policy(features=16), toy_env(COUNT, recall=False, length=5)
    collector = Collector(env, policy, seed=3)
    rollout = Rollout(**zeros(rollout_specs(STEPS, COUNT, policy)))
    collector.collect(rollout)
    collector.collect(rollout)
    logits, values, _ = policy.unroll(
        rollout.patches, rollout.facet, rollout.start_state, rollout.episode_start
    )
    torch.testing.assert_close(rollout.value, values, rtol=0, atol=1e-6)
    chosen = torch.distributions.Categorical(logits=logits).log_prob(rollout.action).sum(-1)
    torch.testing.assert_close(rollout.log_probability, chosen, rtol=0, atol=1e-5)
    assert torch.equal(rollout.episode_start[1:], rollout.done[:-1])


def test_a_restored_collector_continues_identically():
    first, _ = collect(2, deferred=False, recall=False, length=5)
    first.statistics.take()
    second, _ = collect(0, deferred=False, recall=False, length=5)
    second.set_state({name: np.array(value) for name, value in first.get_state().items()})
    rollouts = [Rollout(**zeros(rollout_specs(STEPS, COUNT, first.policy))) for _ in range(2)]
    for collector, rollout in zip((first, second), rollouts, strict=True):
        collector.collect(rollout)
    for name, tensor in rollouts[0].tensors().items():
        assert torch.equal(tensor, rollouts[1].tensors()[name]), name
    one, other = first.statistics.take(), second.statistics.take()
    np.testing.assert_array_equal(one.episode_return, other.episode_return)


def test_a_facet_without_knowledge_is_rejected():
    env = toy_env(COUNT, recall=False, length=5)
    env.env.facet_ids[3] = 2
    policy = informed_toy_policy(np.ones((2, 4), np.float32))
    with pytest.raises(UserError, match="2 rows and the environment has facet 2"):
        Collector(env, policy, seed=0)
