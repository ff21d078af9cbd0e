"""Objects that can be targets, each an MJCF file beside this module."""

from pathlib import Path

from knowarm.world.target import Target

_FOLDER = Path(__file__).parent

TARGETS: dict[str, Target] = {
    # grasped on its handle, inclined by 45 degrees
    "mug": Target(
        name="mug",
        mjcf=_FOLDER / "mug.xml",
        colours={"red": (1.0, 0.0, 0.0), "blue": (0.0, 0.0, 1.0)},
        coloured_geoms=("cup", "handle_top", "handle_side", "handle_bottom"),
    ),
    # grasped on its stopper, from above
    "bottle": Target(
        name="bottle",
        mjcf=_FOLDER / "bottle.xml",
        colours={"yellow": (1.0, 1.0, 0.0), "purple": (0.4, 0.0, 0.9)},
        coloured_geoms=("belly", "shoulder", "neck"),
    ),
    # grasped on its right edge, horizontally, above half its height
    "cereal_box": Target(
        name="cereal_box",
        mjcf=_FOLDER / "cereal_box.xml",
        colours={"brown": (0.55, 0.27, 0.07), "light_blue": (0.5, 0.7, 0.9)},
        coloured_geoms=("carton",),
    ),
}
"""The paper's targets by name. To add one, put its MJCF file here and add an entry."""
