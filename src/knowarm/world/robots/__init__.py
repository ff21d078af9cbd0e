"""A robot's name goes in; its ``Robot`` description comes out."""

from knowarm.world.robot import Robot
from knowarm.world.robots.irb120 import IRB120
from knowarm.world.robots.tiago import TIAGO

ROBOTS: dict[str, Robot] = {
    "irb120": IRB120,
    "tiago": TIAGO,
}
"""Every robot by name. A new one is a folder beside these and one line here."""
