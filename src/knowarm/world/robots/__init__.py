"""Robots: shipped and known ones by name, each a TOML file; own ones by the path of theirs."""

from pathlib import Path

from knowarm.errors import UserError, shell_command, unknown_name
from knowarm.world.description import SUFFIX, read_description
from knowarm.world.robots.robot import Robot

_FOLDER = Path(__file__).parent

ROBOTS: dict[str, Robot] = {
    name: read_description(_FOLDER / name / f"{name}{SUFFIX}", Robot)
    for name in ("irb120", "tiago")
}
"""Shipped robots by name. To add one, put its two files in a folder here and add its name."""

KNOWN_ARMS = {
    file.stem: file for file in sorted((_FOLDER / "known").glob(f"*{SUFFIX}"))
}
"""Descriptions of arms whose model files lie in a MuJoCo Menagerie checkout, by name."""

DEFAULT_ROBOT = "irb120"
"""Robot of an ``EnvConfig`` that names none."""

DEMO_ROBOT = "tiago"
"""Robot of `knowarm demo`: the one that learns in the fewest steps."""


def find_robot(name: str) -> Robot:
    """Return the shipped robot or known arm of a name, or that of a TOML file."""
    if name.endswith(SUFFIX):
        return read_description(Path(name), Robot)
    if name in KNOWN_ARMS:
        return read_description(KNOWN_ARMS[name], Robot)
    if name not in ROBOTS:
        raise unknown_robot(name)
    return ROBOTS[name]


def unknown_robot(name: str) -> UserError:
    """Return the error for a name or file that is no robot."""
    if not Path(name).suffix and not Path(name).is_file():
        return unknown_name("robot", name, [*ROBOTS, *KNOWN_ARMS])
    if not Path(name).exists():
        return UserError(
            f"There is no file {name!r}. Give the path of a robot's {SUFFIX} file, or a name that "
            "`knowarm list robots` shows."
        )
    if name.lower().endswith((".xml", ".mjcf", ".urdf", ".xacro")):
        return UserError(
            f"{name!r} is a model file. Draft a description of it, and name that instead: "
            f"{shell_command('doctor', '--robot', name, '--write', f'ROBOT{SUFFIX}')}"
        )
    return UserError(
        f"{name!r} is no description of a robot, which is a {SUFFIX} file. Other models than URDF, "
        "xacro and MJCF are not read: convert it to one of these."
    )
