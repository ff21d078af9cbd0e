"""Known arms: descriptions of arms whose model files lie in a MuJoCo Menagerie checkout."""

import os
import tomllib
from dataclasses import dataclass
from pathlib import Path

from knowarm.errors import UserError

SCHEME = "menagerie"  # ``mjcf = "menagerie:folder/file.xml"`` names a file of the Menagerie
VARIABLE = "KNOWARM_MENAGERIE"  # Environment variable with the folder of a Menagerie checkout
HOW_TO_GET = (
    "git clone --depth 1 https://github.com/google-deepmind/mujoco_menagerie, then set "
    f"{VARIABLE} to its folder"
)

KNOWN_ARMS = {file.stem: file for file in sorted((Path(__file__).parent / "known").glob("*.toml"))}
"""Descriptions by name."""


@dataclass(frozen=True, kw_only=True)
class KnownArm:
    """An arm that is known by name."""

    name: str  # Name by which users select it
    title: str  # Name for readers
    mjcf: Path | None  # Its model file; None if there is none on this machine


def menagerie_folder() -> Path:
    """Return the folder in which the Menagerie is searched: the variable's, or a cache."""
    if folder := os.environ.get(VARIABLE):
        return Path(folder)
    cache = os.environ.get("ROBOT_DESCRIPTIONS_CACHE")
    root = Path(cache) if cache else Path.home() / ".cache" / "robot_descriptions"
    return root / "mujoco_menagerie"


def find_file(inside: str) -> Path | None:
    """Return the path of a file of the Menagerie; None if it is not on this machine."""
    file = menagerie_folder() / inside
    return file if file.is_file() else None


def menagerie_file(inside: str, owner: str) -> Path:
    """Return the path of a file of the Menagerie."""
    found = find_file(inside)
    if found is None:
        raise UserError(
            f"{owner} needs {inside!r} of the MuJoCo Menagerie, which was not found in "
            f"{menagerie_folder()}. To get it: {HOW_TO_GET}."
        )
    return found


def known_arms() -> list[KnownArm]:
    """List the known arms and where their files are."""
    arms = []
    for name, file in KNOWN_ARMS.items():
        values = tomllib.loads(file.read_text(encoding="utf-8"))
        inside = values["mjcf"].removeprefix(f"{SCHEME}:")
        arms.append(KnownArm(name=name, title=values["title"], mjcf=find_file(inside)))
    return arms
