"""Target description: an object to approach, its model file, grasp frame and colours."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from knowarm.config import check_numbers
from knowarm.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Target:
    """An object to approach, shown without physics: objects never collide.

    The MJCF holds one body; its origin is the centre of the bottom, z points up, and +x is the side
    at which it is grasped. A site gives the grasp frame: z is the approach, y the finger opening.
    """

    name: str
    """Name in the knowledge graph and on the command line."""
    mjcf: Path
    """MJCF file with one top-level body."""
    colours: Mapping[str, tuple[float, float, float]]
    """Possible colours by name, RGB in 0..1; the first is used if colours are fixed."""
    coloured_geoms: tuple[str, ...]
    """Names of the geoms that have this colour; the others keep the file's."""
    grasp_site: str = "grasp"
    """Site of the grasp frame; it is never visible."""

    def __post_init__(self) -> None:
        check_numbers(self)
        if not self.colours:
            raise UserError(f"Target {self.name!r}: colours is empty; give at least one RGB.")
        for colour, rgb in self.colours.items():
            if len(rgb) != 3 or not all(0 <= value <= 1 for value in rgb):
                raise UserError(
                    f"Target {self.name!r}: colour {colour!r} must be three numbers in 0..1, "
                    f"got {rgb}."
                )
        if not self.coloured_geoms:
            raise UserError(f"Target {self.name!r}: coloured_geoms is empty; name a geom.")
