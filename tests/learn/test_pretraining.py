"""Pretraining: what it learns, that it can be repeated, and what it leaves untouched."""

import dataclasses
import re

import pytest
import torch

from knowarm.errors import UserError
from knowarm.learn import CheckpointStore, Hooks, PPOConfig, PPOTrainer
from knowarm.learn.config import privileged_uses
from knowarm.policy import Policy, PolicyConfig, PolicyShape
from knowarm.world.config import EnvConfig
from knowarm.world.torch_env import TorchReachVectorEnv

CONFIG = PPOConfig(
    num_envs=8,
    rollout_steps=5,
    minibatches=2,
    processes=1,
    matmul_precision="float32",
    pretraining_episodes=30,
)
STEPS = 120


def build(folder=None, hooks=None, **changes):
    env = TorchReachVectorEnv(EnvConfig(max_episode_steps=6, image_size=20), 8, num_threads=1)
    policy = Policy(
        PolicyConfig(features=16, fusion="none"), PolicyShape(joints=6, image_size=20), seed=1
    )
    store = None if folder is None else CheckpointStore(folder, {"robot": "irb120"})
    config = dataclasses.replace(CONFIG, **changes)
    return PPOTrainer(config, policy, env, seed=1, checkpoints=store, hooks=hooks)


def weights(trainer):
    return {name: value.clone() for name, value in trainer.policy.state_dict().items()}


def equal(one, other):
    return all(torch.equal(one[name], other[name]) for name in one)


def test_the_position_of_the_target_is_learned_from_first_images():
    lines = []
    trainer = build(hooks=Hooks(on_text=lines.append), pretraining_episodes=16_000)
    assert trainer._pretrain()
    (error,) = re.findall(r"squared error ([\d.]+)", lines[-1])
    assert float(error) < 0.7  # predicting the mean gives 1


def test_the_same_seed_gives_the_same_weights_and_training_its_own_episodes():
    first, second, without = build(), build(), build(pretraining_episodes=0)
    start = weights(first)
    assert first._pretrain()
    assert second._pretrain()
    assert equal(weights(first), weights(second))
    changed = {
        name.split(".")[0]
        for name, value in weights(first).items()
        if not torch.equal(value, start[name])
    }
    assert changed == {"encoder", "fc", "memory"}
    assert torch.equal(first._collector._image, without._collector._image)
    assert torch.equal(
        first._collector.env.privileged_state, without._collector.env.privileged_state
    )


def test_a_stopped_pretraining_starts_again_and_gives_the_same_weights(tmp_path, monkeypatch):
    monkeypatch.setattr("knowarm.learn.pretraining.ROUND", 8)
    whole = build(tmp_path / "whole")
    whole.train(STEPS)
    asked = []
    hooks = Hooks(should_stop=lambda: asked.append(0) or len(asked) == 3)
    stopped = build(tmp_path / "cut", hooks=hooks)
    result = stopped.train(STEPS)
    assert (result.reason, result.step) == ("stopped", 0)
    assert not (tmp_path / "cut" / "latest").exists()
    again = build(tmp_path / "cut")
    again.train(STEPS)
    assert equal(weights(whole), weights(again))


@pytest.mark.parametrize("updates", [0, 1])
def test_resuming_does_not_pretrain_again(tmp_path, updates):
    whole = build(tmp_path / "whole")
    whole.train(STEPS)
    rows, lines = [], []
    hooks = Hooks(
        on_metrics=rows.append,
        on_text=lines.append,
        should_stop=lambda: len(lines) == 2 and len(rows) == updates,
    )
    stopped = build(tmp_path / "cut", hooks=hooks)
    assert stopped.train(STEPS).step == 40 * updates
    assert [line.split(" for ")[0].split(":")[0] for line in lines] == [
        "pretraining on 32 episodes",
        "pretrained",
    ]
    resumed = build(tmp_path / "cut")
    resumed.resume()
    resumed.train(STEPS)
    for part in ("policy", "optimizer", "state"):
        name = f"latest/{part}.safetensors"
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "cut" / name).read_bytes()


def test_pretraining_uses_the_simulators_state():
    assert privileged_uses(vars(CONFIG)) == ["pretraining"]
    with pytest.raises(UserError, match="pretraining_episodes"):
        dataclasses.replace(CONFIG, pretraining_episodes=-1)
