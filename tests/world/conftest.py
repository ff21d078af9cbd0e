"""Small environments: real ones except for images of 16 x 16 pixels."""

from typing import Any

import pytest
from gymnasium.vector import AutoresetMode

from knowarm.world.config import EnvConfig
from knowarm.world.envs.vector_env import ArmVectorEnv
from tests.world.helpers import MakeEnv


@pytest.fixture
def make_env() -> MakeEnv:
    """Build a vector environment of small images from fields of ``EnvConfig``."""

    def make(
        num_envs: int = 3,
        autoreset: AutoresetMode = AutoresetMode.SAME_STEP,
        num_threads: int = 1,
        **options: Any,
    ) -> ArmVectorEnv:
        config = EnvConfig(**{"image_size": 16} | options)
        return ArmVectorEnv(config, num_envs, num_threads, autoreset)

    return make
