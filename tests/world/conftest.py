"""Small environments: 16 x 16 pixels draw in no time, and the rest is the real thing."""

from collections.abc import Callable
from typing import Any

import pytest
from gymnasium.vector import AutoresetMode

from knowarm.world.config import EnvConfig
from knowarm.world.vector_env import ReachVectorEnv

MakeEnv = Callable[..., ReachVectorEnv]


@pytest.fixture
def make_env() -> MakeEnv:
    """Build a vector environment of small images from fields of ``EnvConfig``."""

    def make(
        num_envs: int = 3,
        autoreset: AutoresetMode = AutoresetMode.SAME_STEP,
        num_threads: int = 1,
        **options: Any,
    ) -> ReachVectorEnv:
        config = EnvConfig(**{"image_size": 16} | options)
        return ReachVectorEnv(config, num_envs, num_threads, autoreset)

    return make
