"""Torch environment: choice of the backend, final images, and steps that do not wait for a GPU."""

from collections import Counter
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode
from torch.utils._python_dispatch import TorchDispatchMode

import knowarm  # noqa: F401 (registers the ids)
from knowarm.errors import UserError
from knowarm.world import torch_env
from knowarm.world.backends.mujoco import MujocoSimulator
from knowarm.world.backends.warp import WarpSimulator
from knowarm.world.config import EnvConfig
from knowarm.world.held_out import HeldOut
from knowarm.world.step_graph import WARM_UP_STEPS
from knowarm.world.torch_env import TorchReachVectorEnv
from knowarm.world.vector_env import ReachVectorEnv
from knowarm.world.visual_randomization import VisualRandomization
from tests.world.faces import CUDA, FACES, TORCH, WARP

OPTIONS: list[dict[str, Any]] = [
    {},
    {
        "ignore_roll": True,
        "held_out": HeldOut(places=(0, 1, 0, 1)),
        "randomization": VisualRandomization(
            light=0.3, light_angle_deg=9, camera_shift_m=0.1, surface_colour=0.1, distractors=1
        ),
    },
]

WAITS = {
    "aten._local_scalar_dense.default",  # Tensor.item, int(tensor), if tensor
    "aten.nonzero.default",  # and indexing by a mask
    "aten.masked_select.default",
    "aten.lift_fresh.default",  # torch.tensor(number, device=...), copied from the host
}


class Recorder(TorchDispatchMode):
    """Counts the operations that torch executes."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: Counter[str] = Counter()

    def __torch_dispatch__(
        self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None
    ) -> Any:
        self.seen[str(func)] += 1
        return func(*args, **(kwargs or {}))


@pytest.mark.parametrize("options", OPTIONS, ids=["plain", "varied"])
def test_no_operation_of_a_step_waits(options: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    env = WARP.make(dynamics="kinematic", **options)
    env.reset(seed=0)
    stay = torch.zeros((6, 6), dtype=torch.int64)
    # What only the CPU does: drawing selected environments, checking actions and overflows.
    monkeypatch.setattr(env.renderer, "draw", lambda *args, **kwargs: None)
    monkeypatch.setattr(torch_env, "check_actions", lambda *args: None)
    monkeypatch.setattr(env.simulation, "check_overflow", lambda: None)
    with Recorder() as recorder:
        env.step(stay)
    assert recorder.seen["aten.where.self"] > 5, "something was recorded"
    assert not WAITS & set(recorder.seen)
    with Recorder() as other:
        stay[stay > 0].sum().item()
    assert WAITS & set(other.seen), "waiting is noticed"


@pytest.mark.parametrize("face", FACES[3:])
@pytest.mark.parametrize("options", OPTIONS, ids=["plain", "varied"])
def test_a_step_on_a_gpu_never_waits(options: dict, face: Any) -> None:
    env = face.make(**options)
    env.reset(seed=0)
    stay = torch.zeros((6, 6), dtype=torch.int64, device=CUDA.device)
    for _ in range(WARM_UP_STEPS + 1):  # recording synchronizes once
        env.step(stay)
    torch.cuda.set_sync_debug_mode("error")
    try:
        for _ in range(15):
            env.step(stay)
    finally:
        torch.cuda.set_sync_debug_mode("default")


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
    assert infos["distance"].data_ptr() == env.task.distance.ctypes.data


def test_the_device_chooses_the_simulator() -> None:
    assert isinstance(TORCH.make(1).simulation, MujocoSimulator)
    assert isinstance(WARP.make(1).simulation, WarpSimulator)


def test_make_vec_takes_a_device() -> None:
    options: dict[str, Any] = {"image_size": 16, "dynamics": "kinematic"}
    env_id = "knowarm/IRB120Reach-v0"
    env = gymnasium.make_vec(env_id, num_envs=2, device="cpu", **options)
    assert isinstance(env.unwrapped, TorchReachVectorEnv)
    observation, infos = env.reset(seed=0)
    assert isinstance(observation, torch.Tensor)
    arrays = gymnasium.make_vec(env_id, num_envs=2, **options)
    assert isinstance(arrays.unwrapped, ReachVectorEnv)
    assert (infos["distance"].numpy() == arrays.reset(seed=0)[1]["distance"]).all()
    for given in ({"autoreset": AutoresetMode.DISABLED}, {"render_mode": "rgb_array"}):
        with pytest.raises(UserError, match="leave out device"):
            gymnasium.make_vec(env_id, num_envs=2, device="cpu", **options, **given)
    with pytest.raises(UserError, match="leave out simulator"):
        gymnasium.make_vec(env_id, num_envs=2, simulator="warp", **options)


def test_opengl_is_refused_with_warp() -> None:
    with pytest.raises(UserError, match="renderer 'opengl' draws on the CPU"):
        TorchReachVectorEnv(EnvConfig(renderer="opengl"), 2, simulator="warp")


def test_a_state_of_run_format_1_is_restored() -> None:
    env = TorchReachVectorEnv(EnvConfig(image_size=16), 2)
    env.reset(seed=3)
    state = env.get_state()
    env.step(torch.ones((2, 6), dtype=torch.int64))
    env.set_state(state | {"ended": np.zeros(2, dtype=np.bool_)})
    assert (env.joint_targets.numpy() == state["joint_targets"]).all()
