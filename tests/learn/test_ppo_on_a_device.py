"""PPO learns from the device environment what it learns from the array environment."""

import pytest
import torch

from knowarm.experiment.build import build
from knowarm.experiment.registry import experiment_config
from knowarm.learn import CheckpointStore, Hooks, NumpyToTorch, PPOConfig, PPOTrainer
from knowarm.world.config import EnvConfig
from knowarm.world.torch_env import TorchReachVectorEnv
from knowarm.world.vector_env import ReachVectorEnv
from tests.devices import DEVICES

ENV = EnvConfig(max_episode_steps=8, dynamics="kinematic")
CONFIG = PPOConfig(
    num_envs=4, rollout_steps=10, minibatches=2, matmul_precision="float32", processes=1
)


def train(env, rows, store=None, *, updates=3, resume=False, stop_after=None):
    parts = build(experiment_config("irb120-full-ppo"))
    policy = parts.new_policy(0)
    hooks = Hooks(on_metrics=rows.append, should_stop=lambda: len(rows) == stop_after)
    trainer = PPOTrainer(CONFIG, policy, env, seed=1, hooks=hooks, checkpoints=store)
    if resume:
        trainer.resume()
    trainer.train(40 * updates)
    return trainer


@pytest.mark.slow
@pytest.mark.parametrize("device", DEVICES)
def test_losses_of_the_first_updates_agree(device):
    rows, device_rows = [], []
    # Actions of a GPU come from another generator: there only what precedes them can agree.
    updates = 3 if device == "cpu" else 1
    train(NumpyToTorch(ReachVectorEnv(ENV, 4)), rows, updates=updates)
    train(
        TorchReachVectorEnv(ENV, 4, device=device, simulator="warp"), device_rows, updates=updates
    )
    for row, device_row in zip(rows, device_rows, strict=True):
        assert row["step"] == device_row["step"]
        assert row["entropy"] == pytest.approx(device_row["entropy"], rel=1e-2)
        if device == "cpu":
            assert row["episodes"] == device_row["episodes"]
            assert row["value_loss"] == pytest.approx(device_row["value_loss"], rel=1e-2)
            if row["episodes"]:
                assert row["return_mean"] == pytest.approx(device_row["return_mean"], rel=1e-3)
    assert all(torch.isfinite(torch.tensor(list(row.values()))).all() for row in device_rows)


@pytest.mark.slow
@pytest.mark.parametrize("device", DEVICES)
def test_stop_and_resume(device, tmp_path):
    whole, first, second = [], [], []
    train(
        TorchReachVectorEnv(ENV, 4, device=device, simulator="warp"),
        whole,
        CheckpointStore(tmp_path / "whole", {}),
    )
    cut = CheckpointStore(tmp_path / "cut", {})
    train(TorchReachVectorEnv(ENV, 4, device=device, simulator="warp"), first, cut, stop_after=2)
    train(TorchReachVectorEnv(ENV, 4, device=device, simulator="warp"), second, cut, resume=True)
    assert [row["step"] for row in first + second] == [row["step"] for row in whole]
    if device == "cpu":
        for part in ("policy", "optimizer", "state"):
            name = f"latest/{part}.safetensors"
            one, other = ((tmp_path / run / name).read_bytes() for run in ("whole", "cut"))
            assert one == other
