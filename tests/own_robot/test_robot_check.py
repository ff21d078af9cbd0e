"""Checks of a robot's description: the example passes, and each defect is named with a remedy."""

from pathlib import Path

import pytest

from knowarm.check import Check
from knowarm.own_robot.robot_check import check_agents, check_joints, check_robot
from knowarm.world.config import EnvConfig
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.scene.scene import load_scene
from knowarm.world.tasks.skills.teacher import GoalTable
from tests.world.helpers import EXAMPLES, write_robot

pytestmark = pytest.mark.usefixtures("unfenced")


def result_of(name: str, robot: Path | str, targets: list, **options: object) -> Check:
    """Run the checks of a robot up to a name."""
    return next(
        each for each in check_robot(robot, targets, **options) if each.name == name
    )


def test_example_robot_passes_all_checks(short_search: None) -> None:
    targets = ["bottle", str(EXAMPLES / "bowl.toml")]
    checks = [*check_robot(EXAMPLES / "scara.toml", targets, distance_m=0.03)]
    assert [check for check in checks if not check.ok] == []
    assert {check.name for check in checks} >= {
        "joints",
        "gripper",
        "servos",
        "reach of bowl",
        "green bowl in the image",
    }


@pytest.mark.parametrize(
    ("changes", "name", "words"),
    [
        (
            {"rectangle_centre_m": "[0.75, 0.0]"},
            "reach of bottle",
            "move or shrink the rectangle",
        ),
        ({"camera_fovy_deg": "150.0"}, "yellow bottle in the image", "camera_fovy_deg"),
        ({"tcp_quaternion": "[1.0, 0.0, 0.0, 0.0]"}, "gripper", "tcp_quaternion"),
        ({"servo_frequency_hz": "0.5"}, "servos", "servo_frequency_hz = 5.0 gives 0.0"),
        ({"servo_frequency_hz": "50"}, "servos", "servo_frequency_hz = 5.0 gives 0.0"),
        (
            {"rectangle_half_size_m": "[0.001, 0.001]"},
            "without looking",
            "enlarge the rectangle",
        ),
        ({"joints": '["shoulder", "knee"]'}, "scene", "home has"),
    ],
)
def test_defects_are_named_with_a_remedy(
    changes: dict, name: str, words: str, tmp_path: Path, short_search: None
) -> None:
    check = result_of(name, write_robot(tmp_path, **changes), ["bottle"])
    assert not check.ok
    assert words in check.remedy + check.found


THREE_JOINTS = """
<mujoco><worldbody><body><geom type="cylinder" size=".08 .05" pos="0 0 .05" mass="5"/>
  <body pos="0 0 .1"><joint name="yaw" axis="0 0 1" range="-3 3" damping="2"/>
    <geom type="cylinder" size=".06 .1" pos="0 0 .1" mass="3"/>
  <body pos="0 0 .2"><joint name="shoulder" axis="0 1 0" range="-2 2" damping="2"/>
    <geom type="capsule" fromto="0 0 0 0 0 .35" size=".04" mass="2"/>
  <body name="fore" pos="0 0 .35"><joint name="elbow" axis="0 1 0" range="-2.6 2.6" damping="1"/>
    <geom type="capsule" fromto="0 0 0 0 0 .35" size=".035" mass="1.5"/>
    <site name="tcp" pos="0 0 .38"/></body></body></body></body></worldbody>
  <compiler angle="radian"/></mujoco>"""
DESCRIPTION = """
mjcf = "arm.xml"
joints = ["yaw", "shoulder", "elbow"]
tcp_site = "tcp"
home = [-0.8, 0.2, 2.1]
mpi_rad = 0.068
rectangle_centre_m = [0.432, 0.0]
rectangle_half_size_m = [0.13, 0.288]
target_yaw_deg = 180.0
camera_position_m = [1.4, -1.1, 1.2]
camera_look_at_m = [0.3, 0.0, 0.3]
camera_fovy_deg = 40.0
"""


def test_few_joints_reach_by_the_nearest_pose_that_an_easier_orientation_allows(
    tmp_path, caplog, short_search
) -> None:
    (tmp_path / "arm.xml").write_text(THREE_JOINTS)
    (file := tmp_path / "arm.toml").write_text(DESCRIPTION)
    options = {"angle_deg": 90.0, "ignore_roll": True, "distance_m": 0.03}
    checks = [*check_robot(file, ["bottle"], **options)]
    assert [check for check in checks if not check.ok] == []
    assert "way to the grasps" in {check.name for check in checks}
    config = EnvConfig(
        robot=str(file), targets=("bottle",), success_angle_deg=90.0, ignore_roll=True
    )
    # The teacher of imitation takes such poses too.
    GoalTable(ArmVectorEnv(config, 1).running)
    assert "teacher reaches" not in caplog.text


SURROUNDINGS = """<worldbody><geom type="plane" size="2 2 .1" pos="0 0 .06" rgba="1 0 0 1"/>
  <geom name="plinth" size=".05"/>
  <body name="table" pos=".4 0 .2"><geom type="box" size=".2 .2 .2"/></body>
  <body name="cube" pos=".3 0 .5"><freejoint/><geom type="box" size=".03 .03 .03"/></body>"""


def test_surroundings_in_the_robots_file_are_left_out_and_listed(
    tmp_path: Path,
) -> None:
    (tmp_path / "arm.xml").write_text(THREE_JOINTS)
    (file := tmp_path / "arm.toml").write_text(DESCRIPTION)
    bare = load_scene(str(file), ("bottle",)).model
    (tmp_path / "arm.xml").write_text(THREE_JOINTS.replace("<worldbody>", SURROUNDINGS))
    full = load_scene(str(file), ("bottle",)).model
    assert full.ngeom == bare.ngeom + 1
    assert full.geom("robot/plinth").id >= 0
    assert full.nbody == bare.nbody
    found = next(check_robot(file, ["bottle"], angle_deg=90.0, ignore_roll=True)).found
    assert "left out of arm.xml: an unnamed floor, body 'table', body 'cube';" in found
    assert found.endswith("taken for the robot's base: plinth")


COUPLING = '<equality><joint joint1="elbow" joint2="shoulder"/></equality><compiler'
MILLIMETRES = """<asset><mesh name="m" vertex="-60 -60 0 60 -60 0 0 60 0 0 0 160"/></asset>
<worldbody><geom type="mesh" mesh="m" />"""


@pytest.mark.parametrize(
    ("old", "new", "name", "words"),
    [
        ("<geom ", '<geom group="3" ', "robot in the image", "group 0, 1 or 2"),
        (
            "<geom ",
            '<geom rgba=".6 .6 .63 0" ',
            "robot in the image",
            "group 0, 1 or 2",
        ),
        ("<worldbody>", MILLIMETRES, "size of the robot", 'scale="0.001'),
    ],
)
def test_invisible_and_huge_robots_fail(
    old: str, new: str, name: str, words: str, tmp_path: Path
) -> None:
    (tmp_path / "arm.xml").write_text(THREE_JOINTS.replace(old, new))
    (tmp_path / "arm.toml").write_text(DESCRIPTION)
    options = {"angle_deg": 90.0, "ignore_roll": True}
    check = result_of(name, tmp_path / "arm.toml", ["bottle"], **options)
    assert not check.ok
    assert words in check.remedy


@pytest.mark.parametrize(
    ("old", "new", "ok", "words"),
    [
        (
            ' range="-3 3"',
            "",
            True,
            "yaw [-6.28, 6.28] (no range in the file), shoulder [-2.00, 2",
        ),
        (
            "<site",
            '<joint type="ball" armature=".1"/><site',
            True,
            "unnamed ball joint of body 'fore'",
        ),
        (
            "<compiler",
            COUPLING,
            False,
            "in the file, not in the scene: elbow and shoulder",
        ),
        ("", "", True, "elbow [-2.60, 2.60]"),
    ],
)
def test_joints_that_move_otherwise_than_in_the_file_are_named(
    old: str, new: str, ok: bool, words: str, tmp_path: Path
) -> None:
    (tmp_path / "arm.xml").write_text(THREE_JOINTS.replace(old, new, 1))
    (tmp_path / "arm.toml").write_text(DESCRIPTION)
    check = check_joints(load_scene(str(tmp_path / "arm.toml"), ("bottle",)))
    assert (check.name, check.ok) == ("joints", ok)
    assert check.found.endswith(words) or check.found.startswith(words)


def test_a_way_that_takes_most_of_an_episode_is_named() -> None:
    robot = str(EXAMPLES / "scara.toml")
    config = EnvConfig(robot=robot, targets=("bottle",), mpi_rad=0.015, image_size=1)
    way = next(check_agents(config))
    assert not way.ok
    assert "home or mpi_rad" in way.remedy


@pytest.mark.parametrize(
    ("name", "yaw"), [("can", "75 degrees (target_yaws_deg)"), ("block", "")]
)
def test_an_object_named_as_a_shipped_one_has_the_robots_yaw_for_it(
    name: str, yaw: str, tmp_path: Path
) -> None:
    (tmp_path / "block.xml").write_text(BLOCK)
    file = tmp_path / "block.toml"
    file.write_text(f'name = "{name}"\nmjcf = "block.xml"\ncoloured_geoms = ["body"]\n')
    found = result_of(f"reach of {name}", "irb120", [str(file)]).found
    assert found.endswith(f"at a yaw of {yaw or '-135 degrees'}")


BLOCK = """<mujoco><worldbody><body name="block"><geom name="body" type="box" size=".04 .04 .08"
  pos="0 0 .08"/><site name="grasp" pos="0 0 .15" quat="0 1 0 0"/></body></worldbody></mujoco>"""
