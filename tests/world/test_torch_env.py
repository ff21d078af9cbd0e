"""Torch environment: device, final images, and entry point."""

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode

import knowarm  # noqa: F401 (registers the ids)
from knowarm.errors import UserError
from knowarm.world.config import EnvConfig
from knowarm.world.envs import torch_env
from knowarm.world.envs.torch_env import TorchArmVectorEnv
from knowarm.world.envs.vector_env import ArmVectorEnv
from tests.world.faces import TORCH


def test_the_cpu_draws_final_images_of_truncated_episodes_only(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    env = TORCH.make(4, max_episode_steps=3, dynamics="kinematic")
    drawn = []
    draw = env.renderer.draw

    def count(*args: Any) -> Any:
        drawn.append(len(args[0]))
        return draw(*args)

    monkeypatch.setattr(env.renderer, "draw", count)
    env.reset(seed=0)
    stay = torch.zeros((4, 6), dtype=torch.int64)
    env.step(stay)
    env.reset(options={"reset_mask": np.array([True, False, False, False])})
    env.step(stay)
    infos = env.step(stay)[4]
    assert infos["_final_obs"].tolist() == [False, True, True, True]
    assert drawn == [4, 4, 4, 4, 3, 4]


def test_tensors_share_the_memory_of_the_arrays() -> None:
    env = TORCH.make(3)
    env.reset(seed=0)
    infos = env.step(torch.zeros((3, 6), dtype=torch.int64))[4]
    assert infos["distance"].data_ptr() == env.running.distance.ctypes.data


def test_make_vec_takes_a_device() -> None:
    options: dict[str, Any] = {"image_size": 16, "dynamics": "kinematic"}
    env_id = "knowarm/IRB120Reach-v0"
    env = gymnasium.make_vec(env_id, num_envs=2, device="cpu", **options)
    assert isinstance(env.unwrapped, TorchArmVectorEnv)
    observation, infos = env.reset(seed=0)
    assert isinstance(observation, torch.Tensor)
    arrays = gymnasium.make_vec(env_id, num_envs=2, **options)
    assert isinstance(arrays.unwrapped, ArmVectorEnv)
    assert (infos["distance"].numpy() == arrays.reset(seed=0)[1]["distance"]).all()
    for given in (
        {"autoreset_mode": AutoresetMode.DISABLED},
        {"render_mode": "rgb_array"},
    ):
        with pytest.raises(UserError, match="leave out device"):
            gymnasium.make_vec(env_id, num_envs=2, device="cpu", **options, **given)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_a_device_is_checked() -> None:
    with pytest.raises(UserError, match="device must be 'cuda' or 'cpu', got 'tpu'"):
        TorchArmVectorEnv(EnvConfig(image_size=16), 2, device="tpu")
    with pytest.raises(UserError, match=r"device 'cuda'.*or use the CPU"):
        TorchArmVectorEnv(EnvConfig(image_size=16), 2, device="cuda")


def test_results_are_on_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch_env, "torch_device", torch.device)
    env = TorchArmVectorEnv(EnvConfig(image_size=16), 2, device="meta", num_threads=1)
    env.report_privileged_state = True
    monkeypatch.setattr(
        env, "_checked", lambda actions: np.zeros((2, 6), dtype=np.int64)
    )
    images, infos = env.reset(seed=0)
    results = (
        images,
        infos,
        *env.step(torch.zeros(0)),
        env.knowledge_input,
        env.joint_positions,
    )
    assert len(infos) == 12
    for tensor in leaves(results):
        assert tensor.device.type == "meta"


def leaves(results: Any) -> list[torch.Tensor]:
    """Return all tensors in nested tuples and dictionaries."""
    if isinstance(results, torch.Tensor | np.ndarray):
        return [results] if isinstance(results, torch.Tensor) else []
    values = results.values() if isinstance(results, dict) else results
    return [tensor for value in values for tensor in leaves(value)]
