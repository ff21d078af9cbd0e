"""A step on a GPU launches kernels and waits for nothing."""

from collections import Counter
from typing import Any

import pytest
import torch
from device_pairs import make_pair
from knowarm.world.gpu import env as device_env
from torch.utils._python_dispatch import TorchDispatchMode

from knowarm.world.held_out import HeldOut
from knowarm.world.torch_env import TorchReachVectorEnv
from knowarm.world.visual_randomization import VisualRandomization
from tests.devices import DEVICES

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
    """Counts the operations that torch is asked for."""

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
    env = make_pair("cpu", dynamics="kinematic", **options).device
    env.reset(seed=0)
    stay = torch.zeros((6, 6), dtype=torch.int64)
    # What only the CPU does: images of chosen environments, and a look at actions and overflows.
    monkeypatch.setattr(env.renderer, "draw", lambda *args, **kwargs: None)
    monkeypatch.setattr(device_env, "check_actions", lambda *args: None)
    monkeypatch.setattr(env.simulation, "check_overflow", lambda: None)
    with Recorder() as recorder:
        env.step(stay)
    assert recorder.seen["aten.where.self"] > 5, "something was recorded"
    assert not WAITS & set(recorder.seen)
    with Recorder() as other:
        stay[stay > 0].sum().item()
    assert WAITS & set(other.seen), "waiting is noticed"


@pytest.mark.parametrize("device", DEVICES[1:])
@pytest.mark.parametrize("options", OPTIONS, ids=["plain", "varied"])
def test_a_gpu_is_never_waited_for(options: dict, device: str) -> None:
    env: TorchReachVectorEnv = make_pair(device, **options).device
    env.reset(seed=0)
    stay = torch.zeros((6, 6), dtype=torch.int64, device=device)
    env.step(stay)
    torch.cuda.set_sync_debug_mode("error")
    try:
        for _ in range(15):
            env.step(stay)
    finally:
        torch.cuda.set_sync_debug_mode("default")
