"""Faces of the reaching task that pass the conformance suite, and helpers to compare them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch

from knowarm.world.config import EnvConfig
from knowarm.world.envs.torch_env import TorchArmVectorEnv
from knowarm.world.envs.vector_env import ArmVectorEnv

COUNT = 6
EPISODE_STEPS = 12
METRICS = ("distance", "angle", "target", "colour", "facet", "is_success")


@dataclass(frozen=True)
class Face:
    """One kind of environment.

    Attributes:
        name: its name in test ids.
        create: builds n environments of a config.
        device: where actions have to be; None for NumPy.
    """

    name: str
    create: Callable[[EnvConfig, int], Any]
    device: str | None = None

    def make(self, count: int = COUNT, **options: Any) -> Any:
        """Build environments of small images and short episodes."""
        return self.create(small_config(**options), count)

    def actions(self, values: np.ndarray) -> Any:
        """Convert actions (n, J) to what ``step`` takes."""
        return (
            values
            if self.device is None
            else torch.as_tensor(values, device=self.device)
        )


def small_config(**options: Any) -> EnvConfig:
    """Build a config of small images and short episodes."""
    defaults = {
        "image_size": 16,
        "max_episode_steps": EPISODE_STEPS,
        "colours": "randomized",
    }
    return EnvConfig(**defaults | options)


NUMPY = Face("numpy", lambda config, n: ArmVectorEnv(config, n, 1))
TORCH = Face(
    "torch", lambda config, n: TorchArmVectorEnv(config, n, num_threads=1), "cpu"
)

CUDA = Face(
    "cuda", lambda config, n: TorchArmVectorEnv(config, n, device="cuda"), "cuda"
)

FACES = [pytest.param(face, id=face.name) for face in (NUMPY, TORCH)]
if torch.cuda.is_available():
    FACES.append(pytest.param(CUDA, id=CUDA.name))


@cache
def shared_env(face: Face, robot: str) -> Any:
    """Return an environment that tests share; reset it first."""
    return face.make(robot=robot)


def host(values: Any) -> np.ndarray:
    """Return an array or tensor as an array."""
    return (
        values.cpu().numpy() if isinstance(values, torch.Tensor) else np.asarray(values)
    )


def random_actions(env: Any, generator: np.random.Generator) -> np.ndarray:
    """Draw actions (n, J)."""
    return generator.integers(7, size=env.action_space.shape)


def check_infos(infos: dict, expected: dict, where: np.ndarray) -> None:
    """Assert that infos agree in the rows ``where``, (n,) bool."""
    for name in METRICS:
        assert (host(infos[name])[where] == host(expected[name])[where]).all(), name
        assert (host(infos[f"_{name}"]) == expected[f"_{name}"]).all(), name
