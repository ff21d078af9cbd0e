"""Faces of the reaching task that pass the conformance suite, and helpers to compare them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch

from knowarm.world.config import EnvConfig
from knowarm.world.torch_env import TorchReachVectorEnv
from knowarm.world.vector_env import ReachVectorEnv
from tests.devices import DEVICES

COUNT = 6
EPISODE_STEPS = 12
METRICS = ("distance", "angle", "target", "colour", "facet", "is_success")


@dataclass(frozen=True)
class Face:
    """One kind of environment.

    Attributes:
        name: its name in test ids.
        create: builds n environments of a config.
        exact: whether poses are float64, so that all results equal those of the NumPy face.
        device: where actions have to be; None for NumPy.
    """

    name: str
    create: Callable[[EnvConfig, int], Any]
    exact: bool
    device: str | None = None

    def make(self, count: int = COUNT, **options: Any) -> Any:
        """Build environments of small images and short episodes."""
        return self.create(small_config(**options), count)

    def actions(self, values: np.ndarray) -> Any:
        """Convert actions (n, J) to what ``step`` takes."""
        return values if self.device is None else torch.as_tensor(values, device=self.device)


def small_config(**options: Any) -> EnvConfig:
    """Build a config of small images and short episodes."""
    defaults = {"image_size": 16, "max_episode_steps": EPISODE_STEPS, "colours": "randomized"}
    return EnvConfig(**defaults | options)


def _warp(device: str) -> Callable[[EnvConfig, int], Any]:
    return lambda config, n: TorchReachVectorEnv(config, n, device=device, simulator="warp")


NUMPY = Face("numpy", lambda config, n: ReachVectorEnv(config, n, 1), exact=True)
TORCH = Face(
    "torch-mujoco",
    lambda config, n: TorchReachVectorEnv(config, n, num_threads=1),
    exact=True,
    device="cpu",
)
WARP = Face("torch-warp", _warp("cpu"), exact=False, device="cpu")
CUDA = Face("cuda", _warp("cuda"), exact=False, device="cuda")

FACES = [
    pytest.param(NUMPY, id=NUMPY.name),
    pytest.param(TORCH, id=TORCH.name),
    pytest.param(WARP, id=WARP.name),
    pytest.param(CUDA, id=CUDA.name, marks=DEVICES[1].marks),
]


@cache
def shared_env(face: Face, robot: str) -> Any:
    """Return an environment that tests share, since Warp's take long to build; reset it first."""
    return face.make(robot=robot)


def host(values: Any) -> np.ndarray:
    """Return an array or tensor as an array."""
    return values.cpu().numpy() if isinstance(values, torch.Tensor) else np.asarray(values)


def random_actions(env: Any, generator: np.random.Generator) -> np.ndarray:
    """Draw actions (n, J)."""
    return generator.integers(7, size=env.action_space.shape)


def images_agree(face: Face, images: Any, expected: np.ndarray) -> bool:
    """Compare images; in float32 an edge may fall on the other side of a sample's ray."""
    differ = (host(images) != expected).any(axis=-1)
    return not differ.any() if face.exact else bool(differ.mean() < 0.01)


def check_infos(face: Face, infos: dict, expected: dict, where: np.ndarray) -> None:
    """Assert that infos agree in the rows ``where``, (n,) bool."""
    for name in METRICS:
        got, want = host(infos[name])[where], expected[name][where]
        assert got == pytest.approx(want, abs=0 if face.exact else 2e-4), name
        assert (host(infos[f"_{name}"]) == expected[f"_{name}"]).all(), name
