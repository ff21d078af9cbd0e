"""The bottle's model file goes in; its ``Target`` description comes out."""

from pathlib import Path

from knowarm.world.target import Target

BOTTLE = Target(
    name="bottle",
    mjcf=Path(__file__).with_name("bottle.xml"),
    colours={"yellow": (1.0, 1.0, 0.0), "purple": (0.4, 0.0, 0.9)},
    coloured_geoms=("belly", "shoulder", "neck"),
)
"""The paper's bottle: grasped on its stopper, from above."""
