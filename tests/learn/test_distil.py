"""Imitation of a teacher: practice schedule, targets, and the trainer on the real task."""

import dataclasses

import numpy as np
import pytest
import torch

from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.learn import DistilConfig, DistilTrainer, Hooks, PPOConfig
from knowarm.learn.algorithms import privileged_uses
from knowarm.learn.distil import WAY_BOUND, WAY_SCALE
from knowarm.learn.learner import add_gradient
from knowarm.learn.parallel.shared_tensors import flatten_parameters
from knowarm.policy import Policy, PolicyConfig, PolicyShape
from knowarm.world.config import EnvConfig
from knowarm.world.envs.torch_env import TorchArmVectorEnv
from tests.learn.toys import toy_env, toy_policy

CONFIG = DistilConfig(
    num_envs=8, rollout_steps=6, minibatches=2, processes=1, matmul_precision="float32"
)


def trainer(config=CONFIG, seed=5):
    env = TorchArmVectorEnv(
        EnvConfig(max_episode_steps=9, image_size=20), 8, num_threads=1
    )
    shape = PolicyShape(joints=6, image_size=20)
    policy = Policy(PolicyConfig(features=16, fusion="none"), shape, seed=seed)
    rows = []
    hooks = Hooks(on_metrics=rows.append)
    return DistilTrainer(config, policy, env, seed=seed, hooks=hooks), rows


def test_the_share_of_practice_starts_falls_from_all_to_none():
    config = DistilConfig(practice_until=0.5)
    seen = [config.practice_share_at(progress) for progress in (0.0, 0.25, 0.5, 1.0)]
    assert seen == [1.0, 0.5, 0.0, 0.0]


def test_targets_are_what_the_teacher_says_before_each_step():
    built, _ = trainer(dataclasses.replace(CONFIG, glimpse_until=0.0))
    lessons, env = [], built._collector.env
    teach = env.teach
    env.teach = lambda: lessons.append(teach()) or lessons[-1]
    built.train(48)
    actions, way = (torch.stack(each) for each in zip(*lessons, strict=True))
    targets = built._learner.targets
    assert torch.equal(targets["actions"], actions)
    expected = (way / WAY_SCALE).clamp(-WAY_BOUND, WAY_BOUND)
    assert torch.equal(targets["auxiliary"][..., -6:], expected)
    weight = targets["weights"] / targets["weights"].max()
    torch.testing.assert_close(weight, way.abs().clamp(0.5, CONFIG.way_limit) / 5)
    assert float(targets["weights"].mean()) == pytest.approx(1)


def test_glimpses_are_first_images_of_new_episodes_with_the_teachers_actions():
    built, rows = trainer(dataclasses.replace(CONFIG, glimpse_until=1.0))
    env, places, lessons = built._collector.env, [], []
    teach = env.teach

    def watched():
        places.append(env.running.positions[:, 0].copy())
        lessons.append(teach())
        return lessons[-1]

    env.teach = watched
    built.train(48)
    rollout, targets = built._learner.rollout, built._learner.targets
    assert len(np.unique(np.concatenate(places), axis=0)) == 48, (
        "no place is shown twice"
    )
    assert torch.equal(
        targets["actions"], torch.stack([actions for actions, _ in lessons])
    )
    assert torch.equal(
        rollout.patches[-1], built.policy.patches(built._collector._image)
    )
    assert bool(rollout.episode_start.all())
    assert rows[0]["episodes"] == 0


def test_the_policy_acts_after_the_glimpses():
    built, rows = trainer(
        dataclasses.replace(CONFIG, glimpse_until=0.5, practice_until=0.0)
    )
    built.train(4 * 48)
    assert [row["environment_s"] > 0 for row in rows] == [False, False, True, True]
    assert not bool(built._learner.rollout.episode_start.all())


def test_glimpses_leave_the_recurrent_weights_alone():
    built, _ = trainer(dataclasses.replace(CONFIG, glimpse_until=1.0))
    before = {name: value.clone() for name, value in built.policy.state_dict().items()}
    built.train(48)
    changed = {
        n
        for n, value in built.policy.state_dict().items()
        if not value.equal(before[n])
    }
    assert "memory.weight_hh" not in changed
    assert {
        "encoder.conv1.weight",
        "fc.weight",
        "memory.weight_ih",
        "actor.weight",
    } <= changed


def test_imitation_leaves_the_critic_alone():
    built, _ = trainer()
    before = built.policy.critic.weight.clone()
    built.train(48)
    assert torch.equal(built.policy.critic.weight, before)


def test_imitation_raises_the_agreement_with_the_teacher():
    """Episodes of the same states: without learning the loss would stay at log 7."""
    options = {
        "practice_until": 0.0,
        "glimpse_until": 0.0,
        "learning_rate_schedule": "constant",
    }
    config = dataclasses.replace(CONFIG, **options)
    built, rows = trainer(config)
    built.train(48 * 30)
    losses = [row["imitation_loss"] for row in rows]
    assert losses[0] == pytest.approx(np.log(7), abs=0.3)
    assert np.mean(losses[-5:]) < 1.2


def test_several_processes_compute_the_gradient_of_one():
    one, _ = trainer(dataclasses.replace(CONFIG, num_envs=8, minibatches=1))
    one.train(48)
    network, loss = one._learner.network, one._learner._loss
    rollout, targets, ids = one._learner.rollout, one._learner.targets, torch.arange(8)
    gradients = []
    for parts in (ids.chunk(1), ids.chunk(2)):
        network.zero_grad(set_to_none=False)
        for part in parts:
            add_gradient(network, loss, rollout, targets, part, len(part) / 8)
        gradients.append(
            torch.cat([p.grad.flatten() for p in network.parameters()]).clone()
        )
    torch.testing.assert_close(gradients[0], gradients[1], rtol=1e-4, atol=1e-6)


def test_the_algorithm_is_marked_as_privileged_in_training():
    uses = privileged_uses(to_dict(DistilConfig()))
    assert uses == ["auxiliary loss", "teacher", "practice starts", "glimpses"]
    assert privileged_uses(to_dict(PPOConfig())) == []


def test_an_environment_without_a_teacher_is_an_error():
    env = toy_env(8, recall=False, length=5)
    env.privileged_columns = ("distance/0", "angle/0")
    with pytest.raises(UserError, match="has no teacher"):
        DistilTrainer(CONFIG, toy_policy(), env, seed=0)


def test_evaluations_receive_the_parameters_averaged_over_updates():
    built, _ = trainer()
    expected, after_updates, received = flatten_parameters(built.policy), [], []
    learn = built._learn
    built._learn = lambda: (
        learn(),
        after_updates.append(flatten_parameters(built.policy)),
    )[0]
    built.train(48 * 3)
    built._evaluations.submit = lambda step, values: received.append(values)
    built._submit_evaluation()
    for values in after_updates:
        expected += (values - expected) / 15
    np.testing.assert_allclose(built._average, expected, atol=1e-6)
    assert not np.array_equal(built._average, after_updates[-1])
    assert np.array_equal(received[-1], built._average)
