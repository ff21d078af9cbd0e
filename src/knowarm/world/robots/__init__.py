"""Robots: their descriptions, titles and Gymnasium ids. MJCF files are in the folders beside."""

from dataclasses import dataclass
from pathlib import Path

from knowarm.world.robots.robot import Area, Robot, Table


@dataclass(frozen=True, kw_only=True)
class RobotEntry:
    """A robot of the registry."""

    gym_name: str
    """Its part of the Gymnasium ids, as "IRB120" of ``knowarm/IRB120Reach-v0``."""
    robot: Robot
    """Description from which a scene is built."""

    @property
    def title(self) -> str:
        """Name for readers, as in "ABB IRB120"."""
        return self.robot.title


_FOLDER = Path(__file__).parent

_FROM_ABOVE = (
    *("kettle", "wine_glass", "bowl", "vase", "pot", "jar", "can", "candle", "lamp", "mallet"),
    *("brush", "basket", "clock", "toolbox", "dumbbell", "bell", "globe"),
)
_FROM_THE_SIDE = ("teapot", "pitcher", "pan", "flashlight", "bucket", "watering_can", "book")
"""Objects of the choose task by the direction of their grasp."""

_IRB120 = Robot(
    name="irb120",
    title="ABB IRB120",
    mjcf=_FOLDER / "irb120" / "irb120.xml",
    joints=("joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"),
    tcp_site="tcp",
    fingers=("finger_left", "finger_right"),
    # grasps that exact poses do not lift at all places: docs/results/grasp.md
    not_liftable={
        "bowl": "solid rim, wider at the grasp than the fingers are apart",
        "jar": "lid 100 mm wide",
        "can": "rim 72 mm wide, fingers 64 mm apart",
        "lamp": "shade wider than the fingers are apart at their tips",
        "book": "as thick as the fingers are apart; turns in the grip",
        "bucket": "fingers come down on both halves of the handle",
        "flashlight": "finger tips end 6 mm before the tube's axis and squeeze it out",
        "dumbbell": "finger tips reach 3 mm below the top of the bar",
        "teapot": "turns in the grip",
    },
    # upright and with the wrist turned: far from every grasp, see docs/decisions.md
    home=(0.0, 0.0, 0.2, -0.4, -0.28, 1.44),
    mpi_rad=0.05,
    # the paper's 60 x 20 cm rectangle, on the floor in front of the robot
    rectangle_centre_m=(0.47, 0.0),
    rectangle_half_size_m=(0.10, 0.30),
    # where the gripper reaches all objects of the choose task, also low ones from above
    # and where it reaches both parts of those of the purpose task, one of which faces it
    areas={
        "choose": Area(centre_m=(0.44, 0.0), half_size_m=(0.07, 0.29)),
        "lift": Area(centre_m=(0.445, 0.0), half_size_m=(0.02, 0.20)),
        "purpose": Area(
            centre_m=(0.43, 0.0),
            half_size_m=(0.06, 0.29),
            target_yaws_deg=dict.fromkeys(("bottle", *_FROM_ABOVE, *_FROM_THE_SIDE), 180.0),
        ),
    },
    # directions in which the wrist stays within its range and the ways to two grasps have little
    # in common
    target_yaw_deg=-135.0,
    target_yaws_deg={"mug": -195.0, "bottle": 75.0}
    | dict.fromkeys(_FROM_ABOVE, 75.0)
    | dict.fromkeys(_FROM_THE_SIDE, -150.0),
    # at the right front of the robot; the view contains the workspace but not the robot's base
    camera_position_m=(1.25, -0.90, 0.95),
    camera_look_at_m=(0.42, -0.03, 0.31),
    camera_fovy_deg=40.0,
)
"""6 joints, reach .580 m to the wrist centre, two-finger gripper."""

_TIAGO = Robot(
    name="tiago",
    title="PAL TIAGo",
    mjcf=_FOLDER / "tiago" / "tiago.xml",
    joints=tuple(f"arm_{i}_joint" for i in range(1, 8)),
    tcp_site="tcp",
    fingers=("finger_left", "finger_right"),
    not_liftable={
        "bowl": "solid rim, wider at the grasp than the fingers are apart",
        "jar": "lid 100 mm wide",
        "lamp": "shade wider than the fingers are apart at their tips",
        "pot": "finger tips stand on the lid before they reach the knob",
        "bucket": "fingers come down on both halves of the handle",
    },
    home=(0.206, -0.036, -1.35, 1.81, 0.52, 0.0, 0.95),
    mpi_rad=0.042,
    table=Table(half_size_m=(0.25, 0.35), centre_m=(0.78, -0.08), height_m=0.60),
    # the paper's 20 x 25 cm rectangle
    rectangle_centre_m=(0.70, -0.08),
    rectangle_half_size_m=(0.10, 0.125),
    areas={
        "choose": Area(centre_m=(0.745, 0.0), half_size_m=(0.08, 0.23)),
        "lift": Area(centre_m=(0.76, 0.10), half_size_m=(0.02, 0.08)),
        "purpose": Area(centre_m=(0.725, 0.0), half_size_m=(0.06, 0.23)),
    },
    target_yaw_deg=-165.0,
    target_yaws_deg={"cereal_box": -135.0, "book": -145.0, "flashlight": -145.0, "pitcher": -145.0},
    turned_grasps=("mug",),
    camera_position_m=(1.35, -0.95, 1.50),
    camera_look_at_m=(0.66, -0.06, 0.78),
    camera_fovy_deg=34.0,
)
"""7 arm joints, torso lift fixed at .35 m, two-finger gripper, table."""

ROBOTS: dict[str, RobotEntry] = {
    "irb120": RobotEntry(gym_name="IRB120", robot=_IRB120),
    "tiago": RobotEntry(gym_name="Tiago", robot=_TIAGO),
}
"""Robots by name. To add one, put its MJCF file in a folder here and add an entry."""

DEFAULT_ROBOT = "irb120"
"""Robot of an ``EnvConfig`` that names none."""

DEMO_ROBOT = "tiago"
"""Robot of `knowarm demo`: the one that learns in the fewest steps."""
