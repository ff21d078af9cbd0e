"""Options go in; the same tasks on the CPU and on a device come out."""

from dataclasses import dataclass
from functools import cache
from typing import Any

from knowarm.world.config import EnvConfig
from knowarm.world.torch_env import TorchReachVectorEnv
from knowarm.world.vector_env import ReachVectorEnv

COUNT = 6
EPISODE_STEPS = 12


@dataclass(frozen=True)
class Pair:
    """The same tasks twice: NumPy's on the CPU, and tensors on a device."""

    host: ReachVectorEnv
    device: TorchReachVectorEnv


def make_pair(device: str, count: int = COUNT, **options: Any) -> Pair:
    """Build a pair of environments of small images and short episodes."""
    config = EnvConfig(
        **{"image_size": 16, "max_episode_steps": EPISODE_STEPS, "colours": "randomized"} | options
    )
    return Pair(
        ReachVectorEnv(config, count, 1),
        TorchReachVectorEnv(config, count, device=device, simulator="warp"),
    )


@cache
def shared_pair(device: str, robot: str) -> Pair:
    """The pair of dynamic environments that tests share; reset it with a seed before use."""
    return make_pair(device, robot=robot)
