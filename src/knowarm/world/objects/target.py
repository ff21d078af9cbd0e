"""Target: the description of an object that can be approached."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from knowarm.config import check_values
from knowarm.errors import UserError

COLOURS: dict[str, tuple[float, float, float]] = {
    "red": (1.0, 0.0, 0.0),
    "orange": (1.0, 0.5, 0.0),
    "yellow": (1.0, 1.0, 0.0),
    "green": (0.0, 0.6, 0.1),
    "cyan": (0.0, 0.85, 0.85),
    "blue": (0.0, 0.0, 1.0),
    "purple": (0.45, 0.0, 0.85),
    "pink": (1.0, 0.45, 0.75),
    "brown": (0.55, 0.27, 0.07),
}
"""Colours of the objects that can have any; RGB in 0..1."""


MESHES = (".obj", ".stl", ".dae", ".ply", ".glb", ".gltf", ".fbx", ".off", ".3mf")
OTHER_MODELS = (".urdf", ".xacro", ".sdf", ".usd", ".usda", ".usdz", ".blend")


def refuse_model(what: str, path: Path) -> None:
    """Refuse a mesh or a model of another format in place of an object's MJCF or TOML file."""
    suffix = path.suffix.lower()
    if suffix not in MESHES + OTHER_MODELS:
        return
    kind = "a mesh" if suffix in MESHES else f"a model in the format {suffix}"
    raise UserError(
        f"{what} is {str(path)!r}, which is {kind}. An object is an MJCF file with one body, which "
        "may hold meshes, and a site `grasp`, and a TOML file beside it, such as "
        "examples/own_robot/bowl.xml and bowl.toml; docs/how-to/own-object.md shows how to write "
        "them."
    )


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of an object with a grasp frame of its own: the target ``object.part``."""

    site: str
    """Site of the grasp frame."""
    geoms: tuple[str, ...]
    """Geoms that are the part."""


class AttributeCode(NamedTuple):
    """Attributes and kind of an object among all that its templates know, as numbers."""

    values: tuple[float, ...]
    """1 for an attribute that it has and -1 for one that it lacks; 0 for the place; 1 for its kind
    and 0 for the others."""
    exclusive: int
    """Number of the first attributes, of which an object has exactly one."""
    attributes: int
    """Number of all attributes."""


@dataclass(frozen=True, kw_only=True)
class Target:
    """An object to approach, shown without physics unless the task makes it solid.

    The MJCF holds one body; its origin is the centre of the bottom, z points up, and +x is the side
    at which it is grasped. A site gives the grasp frame: z is the approach, y the finger opening.
    """

    name: str
    """Name in the knowledge graph and on the command line."""
    mjcf: Path
    """MJCF file with one top-level body."""
    colours: Mapping[str, tuple[float, float, float]] = field(
        default_factory=lambda: COLOURS
    )
    """Possible colours by name, RGB in 0..1; the first is used if colours are fixed."""
    coloured_geoms: tuple[str, ...]
    """Names of the geoms that have this colour; the others keep the file's."""
    grasp_site: str = "grasp"
    """Site of the grasp frame; it is never visible."""
    round_grasp: bool = False
    """Whether it is round about the approach, so that the robot's ``grasp_turns_deg`` may turn the
    fingers."""
    parts: Mapping[str, Part] = field(default_factory=dict)
    """Parts at which it can be grasped."""
    part_geoms: tuple[str, ...] = ()
    """Geoms of the part that is grasped, drawn with it where other parts of the same object are
    targets too; the first part draws what belongs to none."""
    mass_kg: float | None = None
    """Mass where it is solid [kg], evenly over its shapes; None takes the file's."""
    base_radius_m: float = 0.0
    """Radius of a flat bottom where it is solid, of what is drawn round below [m]; 0 for none."""
    xml: str | None = None
    """MJCF of an object that a template makes, in place of the file's."""
    attributes: tuple[str, ...] = ()
    """Shape and parts of such an object, by which it can be recognized."""
    code: AttributeCode | None = None
    """The same as numbers."""

    def __post_init__(self) -> None:
        check_values(self)
        refuse_model(f"Target {self.name!r}: mjcf", self.mjcf)
        if not self.colours:
            raise UserError(
                f"Target {self.name!r}: colours is empty; give at least one RGB."
            )
        for colour, rgb in self.colours.items():
            if not all(0 <= value <= 1 for value in rgb):
                raise UserError(
                    f"Target {self.name!r}: colour {colour!r} must be three numbers in 0..1, "
                    f"got {rgb}."
                )
        if not self.coloured_geoms:
            raise UserError(
                f"Target {self.name!r}: coloured_geoms is empty; name a geom."
            )
