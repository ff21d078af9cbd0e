"""Learning from privileged state: formulas, effects on training, and what the policy sees."""

import dataclasses

import numpy as np
import pytest
import torch

from knowarm.errors import UserError
from knowarm.learn import DistilConfig, PPOConfig, PPOTrainer, PrivilegedConfig
from knowarm.learn.privileged import (
    AUXILIARY_QUANTITIES,
    RunningNormalizer,
    StateCritic,
    auxiliary_columns,
)
from knowarm.policy import Policy, PolicyConfig, PolicyShape
from knowarm.world.config import EnvConfig
from knowarm.world.envs.torch_env import TorchArmVectorEnv
from tests.learn.toys import toy_env, toy_policy

CPU = torch.device("cpu")
CONFIG = PPOConfig(
    num_envs=8, rollout_steps=10, minibatches=2, processes=1, matmul_precision="float32"
)
OPTIONS = {
    "critic": {"critic": True},
    "auxiliary": {"auxiliary_coef": 0.5},
    "progress": {"progress_coef": 1.0},
    "thresholds": {"threshold_factor": 50.0},
}


def config_with(gamma=0.95, **privileged):
    return dataclasses.replace(
        CONFIG, gamma=gamma, privileged=PrivilegedConfig(**privileged)
    )


def build(seed=1, gamma=0.95, **privileged):
    """Create a trainer on the real environment, with episodes of 6 steps."""
    env = TorchArmVectorEnv(
        EnvConfig(max_episode_steps=6, image_size=20), 8, num_threads=1
    )
    policy = Policy(
        PolicyConfig(features=16, fusion="none"),
        PolicyShape(joints=6, image_size=20),
        seed=seed,
    )
    return PPOTrainer(config_with(gamma=gamma, **privileged), policy, env, seed=seed)


def test_the_normalizer_knows_mean_and_deviation_of_all_values_so_far():
    rng = np.random.default_rng(0)
    parts = [rng.normal(3, 7, (n, 4)) for n in (5, 1, 60)]
    normalizer = RunningNormalizer(4, CPU)
    for part in parts:
        normalizer.update(torch.from_numpy(part))
    values = np.concatenate(parts)
    expected = ((values - values.mean(0)) / values.std(0)).clip(-5, 5)
    actual = normalizer(torch.from_numpy(values).float())
    np.testing.assert_allclose(actual.numpy(), expected, rtol=1e-4, atol=1e-5)
    constant = RunningNormalizer(1, CPU)
    constant.update(torch.full((3, 1), 2.0))
    assert constant(torch.tensor([[2.0], [3.0]])).tolist() == [[0.0], [5.0]]


def test_the_critic_learns_a_function_of_the_state():
    states = torch.randn(800, 5, generator=torch.Generator().manual_seed(0))
    returns = states[:, 0] - 0.5 * states[:, 1]
    critic = StateCritic(5, CPU, seed=0)
    before = (critic(states) - returns).square().mean()
    for _ in range(40):
        critic.fit(states, returns)
    assert (critic(states) - returns).square().mean() < 0.1 * before


def test_the_auxiliary_head_predicts_arm_and_target():
    columns = build(critic=True)._collector.env.privileged_columns
    chosen = [columns[i].split("/")[0] for i in auxiliary_columns(columns)]
    assert list(dict.fromkeys(chosen)) == list(AUXILIARY_QUANTITIES)
    assert len(chosen) == 24


def test_values_are_those_of_the_state_before_and_after_each_step():
    trainer = build(critic=True)
    trainer.train(80)
    recorder, rollout = trainer._recorder, trainer._learner.rollout
    state, following = recorder.state, recorder.next_state
    inner = ~rollout.done[:-1]
    assert torch.equal(following[:-1][inner], state[1:][inner])
    ended = rollout.truncated[:-1]
    assert ended.any()
    time = trainer._collector.env.privileged_columns.index("time/0")
    assert (following[:-1][ended][:, time] == 1).all()
    assert (state[1:][ended][:, time] == 0).all()


def test_the_critics_values_enter_the_targets_as_those_of_a_plain_loop():
    """The factor lets episodes terminate; the time limit ends the others."""
    trainer = build(critic=True, progress_coef=0.5, threshold_factor=8.0, gamma=0.9)
    critic, rollout, used = trainer._critic, trainer._learner.rollout, []

    class Watched:
        fit = critic.fit

        def __call__(self, state):
            used.append(critic(state))
            return used[-1]

    trainer._critic = Watched()
    trainer.train(160)
    assert rollout.terminated.any()
    assert rollout.truncated.any()
    reward = trainer.rewards().double().numpy()
    values, following = (each.double().numpy() for each in used[-2:])
    expected = np.zeros(rollout.reward.shape)
    for b in range(rollout.reward.shape[1]):
        carried = 0.0
        for t in reversed(range(rollout.reward.shape[0])):
            ended = bool(rollout.terminated[t, b])
            delta = (
                reward[t, b] + 0.9 * (0.0 if ended else following[t, b]) - values[t, b]
            )
            carried = delta + 0.9 * 0.95 * (
                0.0 if bool(rollout.done[t, b]) else carried
            )
            expected[t, b] = carried
    returns = trainer._learner.targets["returns"].numpy()
    np.testing.assert_allclose(returns, expected + values, rtol=1e-4, atol=1e-5)


def test_progress_is_the_decrease_of_distance_and_angle():
    trainer = build(progress_coef=2.0)
    trainer.train(80)
    recorder, columns = trainer._recorder, trainer._collector.env.privileged_columns
    distance, angle = (columns.index(f"{name}/0") for name in ("distance", "angle"))
    gained = recorder.state - recorder.next_state
    expected = 2 * (100 * gained[..., distance] + 20 / 90 * gained[..., angle])
    torch.testing.assert_close(
        trainer.rewards(), 0.05 * (trainer._learner.rollout.reward + expected)
    )
    assert expected.abs().max() > 0.1


def test_thresholds_shrink_to_the_tasks_while_training_succeeds():
    trainer = build(threshold_factor=1.05)
    curriculum, env = trainer._curriculum, trainer._collector.env
    factors = []
    for success in (0.4, 0.6, 0.7, 0.9, 1.0):
        curriculum.update(success, 0.1)
        factors.append(env.threshold_factor)
    assert factors == pytest.approx([1.05, 1.03, 1.01, 1.0, 1.0])


def test_thresholds_end_at_the_tasks_if_training_fails():
    trainer = build(threshold_factor=3.0, threshold_decrease=0.0)
    factors = []
    for _ in range(10):
        trainer.update(800)
        factors.append(trainer._collector.env.threshold_factor)
    assert factors == pytest.approx([3.0] * 5 + [2.2, 1.4, 1.0, 1.0, 1.0])


def test_larger_thresholds_count_more_successes():
    env = TorchArmVectorEnv(EnvConfig(image_size=8), 16, num_threads=1)
    env.reset(seed=0)
    still = torch.zeros(16, 6, dtype=torch.int64)
    env.threshold_factor = 100.0
    _, _, terminated, _, _ = env.step(still)
    assert terminated.all()
    env.threshold_factor = 1.0
    _, _, terminated, _, _ = env.step(still)
    assert not terminated.any()


@pytest.mark.parametrize("option", OPTIONS)
def test_every_option_changes_the_update(option):
    plain, changed = build(), build(**OPTIONS[option])
    plain.train(160)
    changed.train(160)
    first, second = plain.policy.state_dict(), changed.policy.state_dict()
    assert list(first) == list(second)  # nothing is added to the policy
    assert any(not torch.equal(first[name], second[name]) for name in first)


@pytest.mark.parametrize("option", OPTIONS)
def test_an_environment_without_privileged_state_is_refused(option):
    env = toy_env(8, recall=False, length=5)
    with pytest.raises(
        UserError, match=r"has no threshold_factor|reports no privileged state"
    ):
        PPOTrainer(config_with(**OPTIONS[option]), toy_policy(), env, seed=0)


def test_the_progress_reward_needs_its_columns():
    env = toy_env(8, recall=False, length=5)
    env.privileged_columns = ("a/0", "b/0")
    with pytest.raises(
        UserError, match="progress_coef needs the privileged columns distance/0"
    ):
        PPOTrainer(config_with(progress_coef=1.0), toy_policy(), env, seed=0)


@pytest.mark.parametrize(
    ("config", "field", "value"),
    [
        (PPOConfig, "vf_coef", -1.0),
        (PPOConfig, "ent_coef", -1.0),
        (PrivilegedConfig, "auxiliary_coef", -1.0),
        (PrivilegedConfig, "progress_coef", -0.1),
        (PrivilegedConfig, "threshold_factor", 0.9),
        (DistilConfig, "way_limit", 0.4),
    ],
)
def test_values_out_of_range_are_refused(config, field, value):
    with pytest.raises(UserError, match=field):
        config(**{field: value})
