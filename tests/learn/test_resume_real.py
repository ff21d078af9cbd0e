"""Stop and resume on the real environment, whose state is the large part of a checkpoint."""

from dataclasses import replace

import numpy as np
import pytest

from knowarm.learn import (
    CheckpointStore,
    DistilConfig,
    DistilTrainer,
    Hooks,
    PPOConfig,
    PPOTrainer,
    PrivilegedConfig,
)
from knowarm.policy import Policy, PolicyConfig, PolicyShape
from knowarm.world.config import EnvConfig, facets_of
from knowarm.world.envs.torch_env import TorchArmVectorEnv

CONFIG = PPOConfig(num_envs=4, rollout_steps=6, minibatches=2, processes=1)
FAST = replace(
    CONFIG,
    privileged=PrivilegedConfig(
        critic=True, auxiliary_coef=0.5, progress_coef=1.0, threshold_factor=3.0
    ),
    optimizer="muon",
)


DISTIL = DistilConfig(num_envs=4, rollout_steps=6, minibatches=2, processes=1)


def trainer(folder, config, stop_after=None):
    world = EnvConfig(max_episode_steps=8, colours="randomized")
    table = np.eye(len(facets_of(world)), dtype=np.float32)
    env = TorchArmVectorEnv(world, 4, num_threads=1, table=table)
    policy = Policy(PolicyConfig(), PolicyShape(joints=6, knowledge_dim=len(table)))
    rows = []
    hooks = Hooks(on_metrics=rows.append, should_stop=lambda: len(rows) == stop_after)
    store = CheckpointStore(folder, {"robot": "irb120"})
    kind = DistilTrainer if config is DISTIL else PPOTrainer
    return kind(config, policy, env, seed=5, hooks=hooks, checkpoints=store), rows


@pytest.mark.parametrize(
    "config", [CONFIG, FAST, DISTIL], ids=["plain", "fast", "distil"]
)
def test_a_stopped_and_resumed_training_equals_an_uninterrupted_one_to_the_byte(
    tmp_path, config, monkeypatch
):
    monkeypatch.setattr("knowarm.learn.environment.MIN_SUCCESS", -1.0)
    whole, rows = trainer(tmp_path / "whole", config)
    whole.train(6 * 24)
    stopped, first = trainer(tmp_path / "cut", config, stop_after=2)
    stopped.train(6 * 24)
    resumed, second = trainer(tmp_path / "cut", config)
    resumed.resume()
    resumed.train(6 * 24)
    assert [row["grad_norm"] for row in first + second] == [
        row["grad_norm"] for row in rows
    ]
    for part in ("policy", "optimizer", "state"):
        name = f"latest/{part}.safetensors"
        assert (tmp_path / "whole" / name).read_bytes() == (
            tmp_path / "cut" / name
        ).read_bytes()
