"""Learning from privileged state: formulas, effects on training, and what the policy sees."""

import dataclasses

import numpy as np
import pytest
import torch

from knowarm.errors import UserError
from knowarm.learn import PPOConfig, PPOTrainer
from knowarm.learn import optimizer as optimizer_module
from knowarm.learn.learner import make_learner
from knowarm.learn.optimizer import MUON_PARAMETERS, Float32Muon, PolicyOptimizer
from knowarm.learn.privileged import (
    AUXILIARY_QUANTITIES,
    PrivilegedLearning,
    RunningNormalizer,
    StateCritic,
    auxiliary_columns,
)
from knowarm.learn.rollout import TrainingNetwork
from knowarm.policy import Policy, PolicyConfig, PolicyShape
from knowarm.world.config import EnvConfig
from knowarm.world.envs.torch_env import TorchArmVectorEnv
from tests.learn.toys import fill_with_noise, informed_toy_policy, toy_env, toy_policy

CPU = torch.device("cpu")
CONFIG = PPOConfig(
    num_envs=8, rollout_steps=10, minibatches=2, processes=1, matmul_precision="float32"
)
OPTIONS = {
    "critic": {"critic": "state"},
    "auxiliary": {"auxiliary_coef": 0.5},
    "progress": {"progress_coef": 1.0},
    "thresholds": {"threshold_factor": 50.0},
    "muon": {"optimizer": "muon"},
}


def build(seed=1, **changes):
    """Create a trainer on the real environment, with episodes of 6 steps."""
    env = TorchArmVectorEnv(EnvConfig(max_episode_steps=6, image_size=20), 8, num_threads=1)
    policy = Policy(
        PolicyConfig(features=16, fusion="none"), PolicyShape(joints=6, image_size=20), seed=seed
    )
    return PPOTrainer(dataclasses.replace(CONFIG, **changes), policy, env, seed=seed)


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
    columns = build(critic="state")._collector.env.privileged_columns
    chosen = [columns[i].split("/")[0] for i in auxiliary_columns(columns)]
    assert list(dict.fromkeys(chosen)) == list(AUXILIARY_QUANTITIES)
    assert len(chosen) == 24


def test_values_are_those_of_the_state_before_and_after_each_step():
    trainer = build(critic="state")
    trainer.train(80)
    privileged, rollout = trainer._privileged, trainer._learner.rollout
    state, following = privileged.rollout.state, privileged.rollout.next_state
    inner = ~rollout.done[:-1]
    assert torch.equal(following[:-1][inner], state[1:][inner])
    ended = rollout.truncated[:-1]
    assert ended.any()
    time = trainer._collector.env.privileged_columns.index("time/0")
    assert (following[:-1][ended][:, time] == 1).all()
    assert (state[1:][ended][:, time] == 0).all()


def test_the_critics_values_enter_the_targets_as_those_of_a_plain_loop():
    """The factor lets episodes terminate; the time limit ends the others."""
    trainer = build(critic="state", progress_coef=0.5, threshold_factor=8.0, gamma=0.9)
    privileged, rollout, used = trainer._privileged, trainer._learner.rollout, []
    values_of = privileged.values
    privileged.values = lambda: used.append(values_of()) or used[-1]
    trainer.train(160)
    assert rollout.terminated.any()
    assert rollout.truncated.any()
    reward = 0.05 * (rollout.reward + privileged.progress_reward()).double().numpy()
    values, following = (each.double().numpy() for each in used[-1])
    expected = np.zeros(rollout.reward.shape)
    for b in range(rollout.reward.shape[1]):
        carried = 0.0
        for t in reversed(range(rollout.reward.shape[0])):
            ended = bool(rollout.terminated[t, b])
            delta = reward[t, b] + 0.9 * (0.0 if ended else following[t, b]) - values[t, b]
            carried = delta + 0.9 * 0.95 * (0.0 if bool(rollout.done[t, b]) else carried)
            expected[t, b] = carried
    returns = trainer._learner.targets.returns.numpy()
    np.testing.assert_allclose(returns, expected + values, rtol=1e-4, atol=1e-5)


def test_progress_is_the_decrease_of_distance_and_angle():
    trainer = build(progress_coef=2.0)
    trainer.train(80)
    privileged, columns = trainer._privileged, trainer._collector.env.privileged_columns
    distance, angle = (columns.index(f"{name}/0") for name in ("distance", "angle"))
    before, after = privileged.rollout.state, privileged.rollout.next_state
    gained = before - after
    expected = 2 * (100 * gained[..., distance] + 20 / 90 * gained[..., angle])
    torch.testing.assert_close(privileged.progress_reward(), expected)
    assert expected.abs().max() > 0.1


def test_thresholds_shrink_to_the_tasks_while_training_succeeds():
    trainer = build(threshold_factor=1.05, threshold_success=0.5)
    curriculum, env = trainer._curriculum, trainer._collector.env
    factors = []
    for success in (0.4, 0.6, 0.7, 0.9, 1.0):
        curriculum.update(success)
        factors.append(env.threshold_factor)
    assert factors == pytest.approx([1.05, 1.03, 1.01, 1.0, 1.0])


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


def test_two_processes_compute_the_gradient_of_one():
    table = np.random.default_rng(0).standard_normal((3, 4)).astype(np.float32)
    results = []
    for processes in (1, 2):
        config = dataclasses.replace(CONFIG, num_envs=32, processes=processes, auxiliary_coef=0.5)
        network = TrainingNetwork(informed_toy_policy(table), 5, seed=3)
        learner = make_learner(network, config, "float32", CPU)
        fill_with_noise(learner, facets=3)
        learner.targets.auxiliary.copy_(
            torch.randn(10, 32, 5, generator=torch.Generator().manual_seed(4))
        )
        with learner.running():
            terms = learner.compute_gradient(torch.arange(16))
        results.append((terms.vector(), learner.gradient.clone()))
        assert terms.auxiliary > 0
    for one, two in zip(*results, strict=True):
        torch.testing.assert_close(one, two, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("choice", ["muon", "muon-float32"])
def test_muon_updates_its_matrices_and_adam_the_rest(choice):
    network = TrainingNetwork(toy_policy(), 0)
    parameters = network.parameters_by_name()
    optimizer = PolicyOptimizer(parameters, dataclasses.replace(CONFIG, optimizer=choice))
    for parameter in parameters.values():
        parameter.grad = torch.ones_like(parameter)
    optimizer.step()
    kinds = {}
    for name in optimizer.get_state():
        parameter, _, quantity = name.rpartition("/")
        kinds.setdefault(parameter, set()).add(quantity)
    assert {name for name, kind in kinds.items() if kind == {"momentum_buffer"}} == {
        *MUON_PARAMETERS[choice]
    }
    assert set(kinds) == set(parameters)


def test_muon_multiplies_in_float32_where_the_processor_has_no_bfloat16(monkeypatch):
    """The same update up to the rounding of bfloat16, by the products that are fast there."""
    weights = {}
    for has_bfloat16 in (True, False):
        monkeypatch.setattr(optimizer_module, "cpu_has_bfloat16", lambda has=has_bfloat16: has)
        parameters = TrainingNetwork(toy_policy(), 0).parameters_by_name()
        optimizer = PolicyOptimizer(parameters, dataclasses.replace(CONFIG, optimizer="muon"))
        for _ in range(2):
            for parameter in parameters.values():
                parameter.grad = parameter.detach().sin()
            optimizer.step()
        is_float32 = any(isinstance(each, Float32Muon) for each in optimizer._optimizers)
        assert is_float32 is not has_bfloat16
        weights[has_bfloat16] = parameters["fc.weight"].detach().clone()
    start = TrainingNetwork(toy_policy(), 0).parameters_by_name()["fc.weight"].detach()
    steps = [weights[each] - start for each in (True, False)]
    assert float(steps[0].norm()) == pytest.approx(float(steps[1].norm()), rel=0.02)
    assert float((steps[0] - steps[1]).norm() / steps[0].norm()) < 0.05


def test_a_second_thread_updates_to_the_same_bytes():
    results = []
    for processes in (1, 2):
        parameters = TrainingNetwork(toy_policy(), 0).parameters_by_name()
        config = dataclasses.replace(CONFIG, optimizer="muon")
        optimizer = PolicyOptimizer(parameters, config, processes)
        for _ in range(2):
            for parameter in parameters.values():
                parameter.grad = parameter.detach().sin()
            optimizer.step()
        state = {name: value.tobytes() for name, value in optimizer.get_state().items()}
        weights = {name: p.detach().numpy().tobytes() for name, p in parameters.items()}
        results.append((state, weights))
    assert results[0] == results[1]


def test_an_environment_without_privileged_state_is_refused():
    env = toy_env(8, recall=False, length=5)
    for name, option in OPTIONS.items():
        if name != "muon":
            message = "has no threshold_factor|reports no privileged state"
            with pytest.raises(UserError, match=message):
                PPOTrainer(dataclasses.replace(CONFIG, **option), toy_policy(), env, seed=0)


def test_other_columns_are_enough_without_the_progress_reward():
    env = toy_env(8, recall=False, length=5)
    env.privileged_columns = ("a/0", "b/0")
    config = dataclasses.replace(CONFIG, critic="state")
    assert PrivilegedLearning(config, env, seed=0).critic is not None
    with pytest.raises(UserError, match="progress_coef needs the privileged columns distance/0"):
        PrivilegedLearning(dataclasses.replace(config, progress_coef=1.0), env, seed=0)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("vf_coef", -1.0),
        ("ent_coef", -1.0),
        ("target_kl", 0.0),
        ("reinforcement_coef", 0.0),
        ("auxiliary_coef", -1.0),
        ("progress_coef", -0.1),
        ("threshold_factor", 0.9),
        ("threshold_success", 1.5),
    ],
)
def test_values_out_of_range_are_refused(field, value):
    with pytest.raises(UserError, match=field):
        dataclasses.replace(CONFIG, **{field: value})
