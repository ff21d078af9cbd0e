"""Types and files shared by the tests of the world."""

from collections.abc import Callable
from pathlib import Path

from knowarm.world.envs.vector_env import ArmVectorEnv

MakeEnv = Callable[..., ArmVectorEnv]

EXAMPLES = Path(__file__).parents[2] / "examples" / "own_robot"


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
