"""Objects that can be targets, each an MJCF file beside this module and an entry here."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from knowarm.config import check_values
from knowarm.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Target:
    """An object to approach, shown without physics: only objects to lift are solid.

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
    part_geoms: tuple[str, ...] = ()
    """Geoms of the part that is grasped, drawn with it where other parts of the same object are
    targets too; the first part draws what belongs to none."""
    mass_kg: float | None = None
    """Mass where it is lifted [kg], evenly over its shapes; None takes the file's."""
    base_radius_m: float = 0.0
    """Radius of a flat bottom for lifting, for an object drawn round below [m]; 0 for none."""
    xml: str | None = None
    """MJCF of an instance of a family, in place of the file's."""
    attributes: tuple[str, ...] = ()
    """Shape and parts of such an instance, by which it can be recognized."""

    def __post_init__(self) -> None:
        check_values(self)
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


_FOLDER = Path(__file__).parent

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

_OWN_COLOURS = {
    "mug": {"red": (1.0, 0.0, 0.0), "blue": (0.0, 0.0, 1.0)},
    "bottle": {"yellow": (1.0, 1.0, 0.0), "purple": (0.4, 0.0, 0.9)},
    "cereal_box": {"brown": (0.55, 0.27, 0.07), "light_blue": (0.5, 0.7, 0.9)},
}
"""Colours of the paper's targets."""

_COLOURED_GEOMS: dict[str, tuple[str, ...]] = {
    "mug": ("cup", "handle_top", "handle_side", "handle_bottom"),  # grasped on the inclined handle
    "bottle": ("belly", "shoulder", "neck"),  # grasped on its stopper, from above
    "cereal_box": ("carton",),  # grasped on its right edge, horizontally, above half its height
    "teapot": ("belly", "spout", "handle_top", "handle_side"),
    "kettle": ("belly", "shoulder", "spout"),
    "pitcher": ("belly", "lip", "handle_top", "handle_side", "handle_bottom"),
    "wine_glass": ("foot", "stem", "bowl"),
    "bowl": ("foot", "wall", "rim"),
    "vase": ("belly", "neck"),
    "pot": ("wall",),
    "pan": ("dish",),
    "jar": ("glass",),
    "can": ("wall",),
    "candle": ("wax",),
    "lamp": ("foot", "stem", "shade_top"),
    "flashlight": ("tube", "head"),
    "mallet": ("head",),
    "brush": ("block", "handle"),
    "basket": ("bottom",),
    "bucket": ("wall",),
    "watering_can": ("belly", "spout", "handle_top", "handle_side", "handle_bottom"),
    "clock": ("rim",),
    "book": ("cover_front", "cover_back", "spine"),
    "toolbox": ("box",),
    "dumbbell": ("weight_left", "weight_right"),
    "bell": ("rim", "dome"),
    "globe": ("ball",),
}
"""Geoms in the object's colour, by object: one row and one MJCF file per object."""

_MASS_KG = {
    **{"mug": 0.3, "bottle": 0.5, "cereal_box": 0.4, "teapot": 0.4, "kettle": 0.7, "pitcher": 0.5},
    **{"wine_glass": 0.15, "bowl": 0.35, "vase": 0.5, "pot": 0.7, "pan": 0.5, "jar": 0.4},
    **{"can": 0.4, "candle": 0.2, "lamp": 0.6, "flashlight": 0.2, "mallet": 0.5, "brush": 0.15},
    **{"basket": 0.3, "bucket": 0.3, "watering_can": 0.3, "clock": 0.3, "book": 0.5},
    **{"toolbox": 1.0, "dumbbell": 1.0, "bell": 0.3, "globe": 0.4},
}
"""Mass of each object, as of an empty household thing of its size [kg]; our choice."""

_BASE_RADIUS_M = {"teapot": 0.03, "vase": 0.03}
"""Flat bottom of the objects whose shapes touch the ground in one point [m]."""

TARGETS: dict[str, Target] = {
    name: Target(
        name=name,
        mjcf=_FOLDER / f"{name}.xml",
        colours=_OWN_COLOURS.get(name, COLOURS),
        coloured_geoms=geoms,
        mass_kg=_MASS_KG[name],
        base_radius_m=_BASE_RADIUS_M.get(name, 0.0),
    )
    for name, geoms in _COLOURED_GEOMS.items()
}
"""The paper's three targets and the objects of the choose task, by name. To add one, put its MJCF
file here and add an entry to the tables above."""

CHOOSE_TARGETS = tuple(name for name in TARGETS if name != "cereal_box")
"""Objects of the choose task."""
