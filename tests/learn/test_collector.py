"""Rollouts: contents, continuation, and the values of final observations."""

import numpy as np
import pytest
import torch

from knowarm.errors import UserError
from knowarm.learn.rollout import Collector, Rollout, infer_step
from tests.learn.toys import informed_toy_policy, toy_env, toy_policy

COUNT, STEPS = 8, 12


def collect(rollouts, *, recall, length, **options):
    """Collect some rollouts with an untrained policy; return collector and copies of them."""
    policy, env = (
        toy_policy(features=16),
        toy_env(COUNT, recall=recall, length=length, staggered=True),
    )
    collector = Collector(env, policy, seed=3, **options)
    rollout = Rollout.zeros(STEPS, COUNT, policy)
    collected = []
    for _ in range(rollouts):
        collector.collect(rollout)
        collected.append(
            {name: tensor.clone() for name, tensor in rollout.tensors().items()}
        )
    return collector, collected


def test_final_observations_have_no_value_where_none_is_wanted():
    _, rollouts = collect(2, recall=False, length=5, final_values=False)
    for rollout in rollouts:
        assert rollout["truncated"].any()
        assert not rollout["final_value"].any()


def test_a_greedy_collector_takes_the_most_probable_actions():
    logits = []

    def infer(rollout, t, image, state):
        logit, state = infer_step(policy, rollout, t, image, state)
        logits.append(logit)
        return logit, state

    policy = toy_policy(features=16)
    env = toy_env(COUNT, recall=False, length=5)
    rollout = Rollout.zeros(STEPS, COUNT, policy)
    Collector(env, policy, seed=3, greedy=True).collect(rollout, infer)
    assert torch.equal(rollout.action, torch.stack(logits).argmax(-1))
    Collector(env, policy, seed=3).collect(rollout, infer)
    assert not torch.equal(rollout.action, torch.stack(logits[STEPS:]).argmax(-1))


def test_a_rollout_holds_what_the_policy_computed():
    policy, env = toy_policy(features=16), toy_env(COUNT, recall=False, length=5)
    collector = Collector(env, policy, seed=3)
    rollout = Rollout.zeros(STEPS, COUNT, policy)
    collector.collect(rollout)
    collector.collect(rollout)
    logits, values, _ = policy.unroll(
        rollout.patches, rollout.knowledge, rollout.start_state, rollout.episode_start
    )
    torch.testing.assert_close(rollout.value, values, rtol=0, atol=1e-6)
    chosen = (
        torch.distributions.Categorical(logits=logits).log_prob(rollout.action).sum(-1)
    )
    torch.testing.assert_close(rollout.log_probability, chosen, rtol=0, atol=1e-5)
    assert torch.equal(rollout.episode_start[1:], rollout.done[:-1])


def test_a_restored_collector_continues_identically():
    first, _ = collect(2, recall=False, length=5)
    first.statistics.take()
    second, _ = collect(0, recall=False, length=5)
    second.set_state(
        {name: np.array(value) for name, value in first.get_state().items()}
    )
    rollouts = [Rollout.zeros(STEPS, COUNT, first.policy) for _ in range(2)]
    for collector, rollout in zip((first, second), rollouts, strict=True):
        collector.collect(rollout)
    for name, tensor in rollouts[0].tensors().items():
        assert torch.equal(tensor, rollouts[1].tensors()[name]), name
    one, other = first.statistics.take(), second.statistics.take()
    np.testing.assert_array_equal(one.episode_return, other.episode_return)


def test_a_facet_without_knowledge_is_rejected():
    env = toy_env(COUNT, np.ones((2, 4), np.float32), recall=False, length=5)
    Collector(env, informed_toy_policy(4), seed=0)
    env.env.knowledge_input[3] = 2
    with pytest.raises(
        UserError, match="2 rows and the environment has episodes of row 2"
    ):
        Collector(env, informed_toy_policy(4), seed=0)
    with pytest.raises(
        UserError, match="the policy expects vectors of 4 float32 numbers"
    ):
        Collector(
            toy_env(COUNT, recall=False, length=5), informed_toy_policy(4), seed=0
        )


class Recorder:
    """A vector environment that keeps what it returned and received, step by step."""

    def __init__(self, env):
        self.env, self.steps = env, []

    def __getattr__(self, name):
        return getattr(self.env, name)

    def reset(self, *, seed=None, options=None):
        result = self.env.reset(seed=seed, options=options)
        self._shown = result[0], self.env.knowledge.clone()
        return result

    def step(self, actions):
        image, knowledge = self._shown
        result = self.env.step(actions)
        final = result[4].get("final_obs", torch.zeros_like(image)).clone()
        self.steps.append((image, knowledge, actions.clone(), *result[1:4], final))
        self._shown = result[0].clone(), self.env.knowledge.clone()
        return result


@pytest.mark.parametrize("recall", [False, True])
@torch.no_grad()
def test_a_rollout_pairs_each_image_with_its_facet_state_and_final_value(recall):
    """The same rollout, written as plain loops over what the environments returned."""
    table = np.random.default_rng(0).standard_normal((4, 6)).astype(np.float32)
    policy = informed_toy_policy(table.shape[1])
    env = toy_env(COUNT, recall=recall, length=5, staggered=True, facets=4, table=table)
    recorder = Recorder(env)
    collector = Collector(recorder, policy, seed=3)
    rollout = Rollout.zeros(STEPS, COUNT, policy)
    state, start = policy.initial_state(COUNT), torch.ones(COUNT, dtype=torch.bool)
    expected_value = None
    for _ in range(3):
        recorder.steps.clear()
        collector.collect(rollout)
        following = torch.zeros(STEPS, COUNT)
        for t, (image, knowledge, action, reward, ended, cut, final) in enumerate(
            recorder.steps
        ):
            _, value, state = policy.step(image, knowledge, state, start)
            torch.testing.assert_close(rollout.value[t], value)
            if expected_value is not None:  # of the rollout before
                torch.testing.assert_close(expected_value, value)
                expected_value = None
            assert torch.equal(rollout.patches[t], policy.patches(image))
            assert torch.equal(rollout.knowledge[t], knowledge)
            assert torch.equal(rollout.action[t], action)
            assert torch.equal(rollout.reward[t], reward.float())
            assert torch.equal(rollout.terminated[t], ended)
            assert torch.equal(rollout.truncated[t], cut)
            if t:
                following[t - 1] = torch.where(
                    rollout.done[t - 1], following[t - 1], value
                )
            none = torch.zeros_like(start)
            final_value = policy.step(final, knowledge, state, none)[1]
            following[t] = torch.where(cut, final_value, 0.0)
            start = ended | cut
        last = torch.where(rollout.done[-1], following[-1], rollout.last_value)
        following[-1] = last
        torch.testing.assert_close(rollout.following(), following)
        expected_value = rollout.last_value.clone()
        assert len(rollout.knowledge.flatten(0, 1).unique(dim=0)) == 4
    assert rollout.done.any()
    assert (rollout.knowledge[1:] != rollout.knowledge[:-1]).any()
