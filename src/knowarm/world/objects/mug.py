"""The mug's model file goes in; its ``Target`` description comes out."""

from pathlib import Path

from knowarm.world.target import Target

MUG = Target(
    name="mug",
    mjcf=Path(__file__).with_name("mug.xml"),
    colours={"red": (1.0, 0.0, 0.0), "blue": (0.0, 0.0, 1.0)},
    coloured_geoms=("cup", "handle_top", "handle_side", "handle_bottom"),
)
"""The paper's mug: grasped on its handle, inclined by 45 degrees."""
