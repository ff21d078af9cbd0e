"""Small environments: real ones except for images of 16 x 16 pixels."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from gymnasium.vector import AutoresetMode

from knowarm.world.config import EnvConfig
from knowarm.world.vector_env import ReachVectorEnv

MakeEnv = Callable[..., ReachVectorEnv]

EXAMPLES = Path(__file__).parents[2] / "examples" / "own_robot"


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


def write_robot(path: Path, **changes: str) -> Path:
    """Write the example robot's file with fields changed; an empty value removes the field."""
    lines = [f"{name} = {value}" for name, value in changes.items() if value]
    for line in (EXAMPLES / "scara.toml").read_text().splitlines():
        name = line.partition("=")[0].strip()
        if name == "mjcf" and "mjcf" not in changes:
            line = f'mjcf = "{EXAMPLES / "scara.xml"}"'
        if name not in changes:
            lines.append(line)
    out = path / "robot.toml"
    out.write_text("\n".join(lines))
    return out
