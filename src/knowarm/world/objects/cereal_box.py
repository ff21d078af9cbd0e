"""The cereal box's model file goes in; its ``Target`` description comes out."""

from pathlib import Path

from knowarm.world.target import Target

CEREAL_BOX = Target(
    name="cereal_box",
    mjcf=Path(__file__).with_name("cereal_box.xml"),
    colours={"brown": (0.55, 0.27, 0.07), "light_blue": (0.5, 0.7, 0.9)},
    coloured_geoms=("carton",),
)
"""The paper's cereal box: grasped on its right edge, horizontally, above half its height."""
