"""Drafts of descriptions: joints, TCP, task, layout, overrides; the draft passes all checks."""

import tomllib
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

from knowarm.errors import UserError
from knowarm.own_robot.draft import (
    _toml,
    draft_robot,
    read_overrides,
    shrink_distance,
)
from knowarm.own_robot.draft_gripper import find_gripper
from knowarm.own_robot.draft_home import Home
from knowarm.own_robot.draft_reach import find_layout
from knowarm.own_robot.draft_view import choose_view
from knowarm.own_robot.robot_check import check_robot
from knowarm.own_robot.scene_image import SIDE, write_scene_image
from knowarm.world.agents import OracleAgent
from knowarm.world.agents.play import play
from knowarm.world.backend import MujocoSimulator
from knowarm.world.config import EnvConfig
from knowarm.world.description import read_description
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.objects import find_targets
from knowarm.world.robots import ROBOTS
from knowarm.world.robots.robot import RealJoint, Robot
from knowarm.world.scene.compose import STOP_RAD
from knowarm.world.scene.scene import build_scene, load_scene
from tests.own_robot.robot_cases import change
from tests.own_robot.test_repair import drafted
from tests.world.helpers import EXAMPLES

pytestmark = pytest.mark.usefixtures("unfenced")

SHIPPED = ROBOTS["irb120"]
HAND = """
<mujoco><worldbody><body name="base"><geom size=".05"/>
  <body name="link1" pos="0 0 .2"><joint name="a" axis="0 0 1" range="-3 3"/><geom size=".05"/>
  <body name="link2" pos="0 0 .2"><joint name="b" axis="0 1 0" range="-3 3"/><geom size=".05"/>
  <body name="link3" pos="0 0 .2"><joint name="c" axis="0 1 0" range="-3 3"/><geom size=".05"/>
  <body name="link4" pos="0 0 .1"><joint name="d" axis="0 0 1" range="-3 3"/>
    <geom type="box" size=".03 .03 .03"/>{inside}
    {fingers}
  </body></body></body></body></body></worldbody></mujoco>"""
FINGERS = """<body name="{0}" pos="{1} 0 .05"><joint name="{0}_slide" type="slide" axis="{1} 0 0"
    range="0 .04"/><geom type="box" size=".01 .01 .04" pos="0 0 .04"/></body>"""


def hand(inside: str = "", fingers: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(HAND.format(inside=inside, fingers=fingers))


def test_tcp_is_the_robots_own_site() -> None:
    gripper = find_gripper(mujoco.MjModel.from_xml_path(str(SHIPPED.mjcf)))
    assert gripper.joints == SHIPPED.joints
    assert gripper.fields == {"tcp_site": "tcp"}
    assert "site 'tcp'" in gripper.how


def test_tcp_lies_between_the_ends_of_two_fingers() -> None:
    both = FINGERS.format("left", 0.02) + FINGERS.format("right", -0.02)
    gripper = find_gripper(hand(fingers=both))
    assert gripper.joints == ("a", "b", "c", "d")
    assert gripper.fields["tcp_body"] == "link4"
    np.testing.assert_allclose(gripper.fields["tcp_position_m"][:2], 0, atol=1e-6)
    assert 0.10 < gripper.fields["tcp_position_m"][2] < 0.13
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.array(gripper.fields["tcp_quaternion"]))
    np.testing.assert_allclose(matrix.reshape(3, 3)[:, 2], [0, 0, 1], atol=1e-5)
    # The fingers open along x of the hand.
    np.testing.assert_allclose(np.abs(matrix.reshape(3, 3)[:, 1]), [1, 0, 0], atol=1e-5)


JAW = """<body name="part" pos=".03 0 .04"><joint name="joint7" axis="0 1 0" range="-.2 1.2"/>
    <geom type="box" size=".005 .01 .03" pos="0 0 .03"/></body>"""
FIXED_JAW = '<geom type="box" size=".005 .01 .03" pos="-.03 0 .06"/>'
PARTNER = """<body name="e" pos="0 0 .1"><joint name="e" axis="0 0 1"/><geom size=".03"/></body>
  </body></body></body></body></body><body name="far"><joint name="f"/><geom size=".03"/>
  <body><body><body><body>"""
COUPLED = '<equality><joint joint1="f" joint2="e"/></equality>'


@pytest.mark.parametrize(
    ("inside", "fingers", "more", "why"),
    [
        (FIXED_JAW, JAW, "", "a jaw moves beside a fixed part"),
        (
            '<site name="end_effector_site" pos="0 0 .1"/>',
            JAW,
            "",
            "site 'end_effector_site' lies",
        ),
        ("", FINGERS.format("jaw", 0.02) + JAW, "", "2 moving parts begin"),
        ("", PARTNER, COUPLED, "joints of several parts are coupled ('f')"),
    ],
)
def test_fingers_are_known_by_structure(
    inside: str, fingers: str, more: str, why: str
) -> None:
    text = HAND.format(inside=inside, fingers=fingers).replace(
        "</mujoco>", f"{more}</mujoco>"
    )
    gripper = find_gripper(mujoco.MjModel.from_xml_string(text))
    assert gripper.joints == ("a", "b", "c", "d")
    assert f"where {why}" in gripper.how
    assert f": a, b, c, d; left out: {'e, f' if more else ''}" in gripper.how


def test_last_joint_without_these_signs_is_the_arms() -> None:
    roll = '<body><joint name="roll" axis="0 0 1"/><geom size=".03" pos=".01 0 .1"/></body>'
    pitch = (
        '<body><joint name="pitch" axis="0 1 0"/><geom size=".03" pos="0 0 .1"/></body>'
    )
    assert find_gripper(hand(FIXED_JAW, roll)).joints[-1] == "roll"
    assert find_gripper(hand(fingers=pitch)).joints[-1] == "pitch"


@pytest.mark.parametrize("before", range(8))
def test_of_two_equal_arms_the_one_not_taken_is_offered(before: int) -> None:
    link = '<body pos="0 0 .3"><joint name="{}{}"/><geom size=".03" pos="0 0 .15"/>{}</body>'
    arms = ["", ""]
    for number in reversed(range(6)):
        arms = [
            link.format(side, number, arm) for side, arm in zip("rl", arms, strict=True)
        ]
    text = f"<mujoco><worldbody>{'<body/>' * before}{arms[0]}{arms[1]}</worldbody></mujoco>"
    gripper = find_gripper(mujoco.MjModel.from_xml_string(text))
    assert gripper.joints == ("r0", "r1", "r2", "r3", "r4", "r5")
    assert 'another arm: joints = ["l0", "l1", "l2", "l3", "l4", "l5"]' in gripper.how


def test_tcp_lies_between_a_jaw_and_the_fixed_one() -> None:
    gripper = find_gripper(hand(FIXED_JAW, JAW))
    np.testing.assert_allclose(gripper.fields["tcp_position_m"][:2], 0, atol=1e-3)
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.array(gripper.fields["tcp_quaternion"]))
    np.testing.assert_allclose(np.abs(matrix.reshape(3, 3)[:, 1]), [1, 0, 0], atol=1e-5)


def test_single_jaw_is_no_joint_of_the_arm() -> None:
    assert find_gripper(hand(fingers=FINGERS.format("jaw", 0.02))).joints == (
        "a",
        "b",
        "c",
        "d",
    )


def test_site_that_points_elsewhere_is_turned() -> None:
    site = '<site name="pinch" pos="0 0 .1" euler="0 90 0"/>'
    gripper = find_gripper(hand(inside=site))
    assert gripper.fields["tcp_site"] == "tcp"
    np.testing.assert_allclose(gripper.fields["tcp_position_m"], [0, 0, 0.1], atol=1e-6)
    assert "'pinch', turned" in gripper.how


def test_arm_without_gripper_gets_a_tcp_in_front_of_its_end() -> None:
    gripper = find_gripper(hand())
    np.testing.assert_allclose(
        gripper.fields["tcp_position_m"], [0, 0, 0.08], atol=1e-6
    )


def test_flange_whose_mesh_extends_backward() -> None:
    back = '<geom type="box" size=".02 .02 .05" pos="0 0 -.06"/><body name="flange" pos="0 0 .02"/>'
    gripper = find_gripper(hand(inside=back))
    # In front, where the wrist goes on
    assert gripper.fields["tcp_position_m"][2] > 0.05


def test_file_without_an_arm_is_refused() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="a"/><geom size=".1"/></body></worldbody></mujoco>'
    )
    with pytest.raises(UserError, match="chain of at least two"):
        find_gripper(model)


def test_layout_keeps_what_is_given_and_names_what_is_not_reached() -> None:
    scene = load_scene("irb120", ("bottle", "mug"))
    given = {"rectangle_centre_m": (0.45, 0.05), "rectangle_half_size_m": (0.05, 0.1)}
    layout = find_layout(
        lambda height: scene, (0.0,), given | {"target_yaw_deg": 180.0}
    )
    assert tuple(layout.centre_m) == given["rectangle_centre_m"]
    assert [branch.yaw_deg for branch in layout.branches] == [180.0, 180.0]
    simulation = MujocoSimulator(scene, 9)
    simulation.set_joints(layout.branches[0].joints)
    reached = simulation.tcp_position[:, :2]
    np.testing.assert_allclose(np.ptp(reached, axis=0), [0.1, 0.2], atol=0.03)
    far = {**given, "rectangle_centre_m": (3.0, 0.0)}
    with pytest.raises(
        UserError, match=r"bottle at 0\.50 m 0, mug at 0\.50 m 0\. Give"
    ):
        find_layout(lambda height: scene, (0.5,), far)


def test_given_yaws_turn_the_grasps_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The layout is searched with unturned grasps, which it turns by the given yaws."""
    scenes = []

    def look(scene_at, *given):
        scenes.append(scene_at(0.0))
        raise UserError("enough")

    monkeypatch.setattr("knowarm.own_robot.draft.find_layout", look)
    for yaws in ({}, {"mug": 90.0}):
        with pytest.raises(UserError, match="enough"):
            draft_robot(SHIPPED.mjcf, ["mug"], {"target_yaws_deg": yaws})
    assert (scenes[0].grasp_matrix == scenes[1].grasp_matrix).all()


@pytest.mark.slow
def test_draft_of_a_six_joint_arm_passes_all_checks(
    tmp_path: Path, short_search: None
) -> None:
    draft = draft_robot(SHIPPED.mjcf, ["mug", "bottle"], {"camera_fovy_deg": 45.0})
    assert (draft.success_angle_deg, draft.ignore_roll) == (15.0, False)
    assert draft.thresholds == {"evaluation_distance_m": draft.distance_m}
    file = tmp_path / "arm.toml"
    file.write_text(draft.toml(file))
    robot = read_description(file, Robot)
    assert robot.camera_fovy_deg == 45.0
    assert robot.joints == SHIPPED.joints
    assert robot.joint_map == {name: RealJoint(name=name) for name in robot.joints}
    failed = [check for check in check_robot(file, ["mug", "bottle"]) if not check.ok]
    assert failed == []
    scene = load_scene(str(file), ("mug", "bottle"))
    half_range = np.median(scene.joint_upper - scene.joint_lower) / 2
    assert robot.start_fraction == min(0.15, round(0.4 / half_range, 3))
    env = ArmVectorEnv(EnvConfig(robot=str(file), targets=("mug", "bottle")), 50)
    results = play(OracleAgent(env), env, evaluation_episodes(env.config, 50, seed=1))
    assert results.success.mean() >= 0.9
    assert 12 <= np.median(results.length) <= 30  # of 50
    image = tmp_path / "arm.png"
    write_scene_image(scene, EnvConfig(robot=str(file)), image)
    assert Image.open(image).size == (2 * SIDE, SIDE)


def test_friction_stops_a_joint_near_its_target(tmp_path: Path) -> None:
    spec = mujoco.MjSpec.from_file(str(SHIPPED.mjcf))
    for joint in spec.joints:
        joint.frictionloss = 3.0
    (tmp_path / "arm.xml").write_text(spec.to_xml())
    rubbed = replace(SHIPPED, mjcf=tmp_path / "arm.xml")
    gains = build_scene(rubbed, find_targets(["mug"])).model.actuator_gainprm[:, 0]
    assert (3.0 / gains <= STOP_RAD + 1e-9).all()
    free = build_scene(SHIPPED, find_targets(["mug"])).model.actuator_gainprm[:, 0]
    assert (gains[-3:] > 2 * free[-3:]).all()  # the wrist's inertia is small


@pytest.mark.slow
def test_arm_with_four_joints_gets_an_easier_orientation() -> None:
    draft = draft_robot(EXAMPLES / "scara.xml", ["mug"], {})
    assert draft.success_angle_deg > 15 or draft.ignore_roll
    assert f"success_angle_deg = {draft.success_angle_deg}" in draft.toml()


THREE_JOINTS = """
<mujoco><compiler angle="radian"/><worldbody><body name="base">
  <geom type="cylinder" size=".08 .1" pos="0 0 .1"/>
  <body name="shoulder" pos="0 0 .2"><joint name="yaw" axis="0 0 1" range="-3 3"/>
  <geom size=".07"/>
  <body name="upper" pos="0 0 .08"><joint name="lift" axis="0 1 0" range="-1.8 1.8"/>
  <geom type="capsule" fromto="0 0 0 0 0 .4" size=".04"/>
  <body name="fore" pos="0 0 .4"><joint name="elbow" axis="0 1 0" range="-2.6 2.6"/>
  <geom type="capsule" fromto="0 0 0 0 0 .4" size=".03"/>
  </body></body></body></body></worldbody></mujoco>"""


@pytest.mark.slow
def test_draft_of_an_arm_with_three_joints_passes_all_checks(
    tmp_path: Path, short_search: None
) -> None:
    """Just below the threshold of the orientation the nearest pose is taken."""
    (tmp_path / "arm.xml").write_text(THREE_JOINTS)
    targets = ("mug", "bottle", "cereal_box")
    draft = draft_robot(tmp_path / "arm.xml", targets, {})
    assert (draft.success_angle_deg, draft.ignore_roll) == (90.0, True)
    (tmp_path / "arm.toml").write_text(draft.toml(tmp_path / "arm.toml"))
    assert draft.distance_m == 0.05
    smaller = shrink_distance(draft, targets).distance_m
    options = {"angle_deg": 90.0, "ignore_roll": True, "distance_m": smaller}
    checks = [*check_robot(tmp_path / "arm.toml", targets, **options)]
    assert [check for check in checks if not check.ok] == []
    assert len(checks) == 17


@pytest.mark.parametrize(
    ("shares", "distance_m"),
    [([0.4], 0.05), ([0.8, 0.6, 0.38], 0.025), ([0.9] * 4, 0.02)],
)
def test_the_distance_of_success_shrinks_until_a_fixed_list_solves_little(
    shares: list[float], distance_m: float, monkeypatch
) -> None:
    tried = []

    def solve(config: EnvConfig, distance_m: float) -> tuple[float, float]:
        assert (config.success_angle_deg, config.ignore_roll) == (60.0, True)
        tried.append(distance_m)
        return shares[len(tried) - 1], 60.0

    monkeypatch.setattr("knowarm.own_robot.draft.fixed_list_success", solve)
    options = {"success_angle_deg": 60.0, "ignore_roll": True, "distance_m": 0.05}
    draft = shrink_distance(replace(drafted(), **options), ["mug"])
    assert draft.distance_m == pytest.approx(distance_m)
    assert tried == pytest.approx([0.05, 0.035, 0.025, 0.02][: len(shares)])
    assert f"within {100 * distance_m:g} cm" in draft.how["success"]


def test_overrides_are_fields_in_tomls_notation() -> None:
    assert read_overrides(["camera_fovy_deg=50", "home=[0.0, 1]"]) == {
        "camera_fovy_deg": 50,
        "home": [0.0, 1],
    }
    area = {"area": {"centre_m": [0.4, 0.0], "half_size_m": [0.1, 0.2]}}
    assert tomllib.loads(f"areas = {_toml(area)}") == {"areas": area}
    with pytest.raises(UserError, match="not TOML"):
        read_overrides(["home=[0.0"])
    with pytest.raises(UserError, match="camera_fovy_deg"):
        read_overrides(["camera_fovy=50"])
    with pytest.raises(UserError, match="Did you mean 'base_position_m'"):
        read_overrides(["base=[0.0, 0.0, 0.4]"])


WALL = '<geom type="box" size=".4 .02 .6" pos=".1 -.3 .6" contype="0" conaffinity="0"/>'


def test_the_camera_looks_past_what_hides_the_targets(tmp_path: Path) -> None:
    text = SHIPPED.mjcf.read_text()
    body = '<body name="base_link">'
    assert body in text
    (tmp_path / "arm.xml").write_text(text.replace(body, body + WALL))
    for mjcf, side in ((SHIPPED.mjcf, "right"), (tmp_path / "arm.xml", "left")):
        scene = build_scene(replace(SHIPPED, mjcf=mjcf), find_targets(["mug"]))
        home = Home(scene.home, 1.0, "")
        _, view, text = choose_view(scene, [home], {"camera_fovy_deg": 40.0})
        assert side in text.partition(": at its start the arm fills")[0]
        assert (view["camera_position_m"][1] < 0) is (side == "right")
        given = {
            "camera_position_m": [2.0, -1.0, 1.0],
            "camera_look_at_m": [0.4, 0.0, 0.3],
        }
        fields = choose_view(scene, [home], {**given, "camera_fovy_deg": 40.0})[1]
        assert fields == {**given, "camera_fovy_deg": 40.0}


def test_the_image_has_the_colours_that_the_policy_sees(tmp_path: Path) -> None:
    robot, bowl = str(EXAMPLES / "scara.toml"), str(EXAMPLES / "bowl.toml")
    scene = load_scene(robot, (bowl,))
    write_scene_image(
        scene, EnvConfig(robot=robot, targets=(bowl,)), tmp_path / "a.png"
    )
    drawn = np.asarray(Image.open(tmp_path / "a.png"), dtype=int)
    wanted = 255 * scene.target_colours[0, 0]
    hue = drawn / np.maximum(drawn.max(axis=-1, keepdims=True), 1)
    assert (np.abs(hue - wanted / wanted.max()).max(axis=-1) < 0.1).sum() > 200


SITES = {
    "the light of PR2": {
        "r_gripper_led_frame": (".025 0 .04"),
        "r_gripper_tool_frame": "0 0 .12",
    },
    "a camera of the tool": {"tool_camera_link": "0 0 .12", "ee_link": "0 0 .12"},
    "a wrist's camera": {"wristcam_tool": "0 0 .12", "gripper": "0 0 .12"},
    "a force sensor": {"tool_ft_sensor": "0 0 .12", "grasp_frame": "0 0 .12"},
    "an optical frame": {"gripper_optical_frame": "0 0 .12", "EndEffector": "0 0 .12"},
    "a tool beside a gripper": {"gripper": "0 0 .1", "tool0": "0 0 .12"},
    "robosuite's axes": {"ee_x": "0 0 .11", "grip_site": "0 0 .12"},
    "a scanner": {"gripper_lidar": "0 0 .12", "ee": "0 0 .12"},
    "a camera by its product": {"grasp_realsense_link": "0 0 .12", "ee": "0 0 .12"},
    "a marker by its kind": {"tool_aruco": "0 0 .12", "ee": "0 0 .12"},
    "a range finder": {"grip_tof_frame": "0 0 .12", "ee": "0 0 .12"},
    "the middle of mass": {"gripper_com": "0 0 .1", "ee": "0 0 .12"},
    "a microphone": {"tool_mic": "0 0 .12", "ee": "0 0 .12"},
    "what carries the gripper": {"gripper_base_link": "0 0 .05", "ee": "0 0 .12"},
    "a mount": {"gripper_mount": "0 0 .05", "attachment_site": "0 0 .12"},
    "a tool changer": {"ToolChanger": "0 0 .05", "flange": "0 0 .12"},
    "a dummy": {"dummy_gripper": "0 0 .12", "end_link": "0 0 .12"},
    "a flange behind the fingers": {"tool0": "0 0 -.02", "attachment_site": "0 0 .11"},
    "a frame beside the fingers": {"left_tcp": "0 .08 .1", "hand_tip": "0 0 .11"},
    "one word": {"gripperframe": "0 0 .12"},
    "in capitals": {"bend": "0 0 .12", "wheel": "0 0 .12", "TCP_LINK": "0 0 .12"},
}
"""Sites between fingers that reach from 5 to 13 cm, of which the last is the tool's."""


@pytest.mark.parametrize("name", SITES)
def test_the_makers_tool_frame_is_taken(name: str) -> None:
    both = FINGERS.format("left", 0.02) + FINGERS.format("right", -0.02)
    sites = ""
    for site, place in SITES[name].items():
        sites += f'<site name="{site}" pos="{place}" euler="0 0 90"/>'
    gripper = find_gripper(hand(sites, both))
    assert gripper.fields["tcp_site"] == [*SITES[name]][-1]


@pytest.mark.parametrize(
    ("sites", "taken"),
    [
        ({"gripper": ".094 0 0", "end_link": "0 0 .05"}, "end_link"),
        ({"tcp_left": "0 .1 .1", "tcp": "0 0 .1"}, "tcp"),
        ({"tcp": "0 .02 .1", "flange": "0 0 .05"}, "tcp"),
        ({"tcp": "0 .1 .1"}, "tcp"),
    ],
)
def test_without_fingers_a_frame_ahead_comes_before_one_beside(
    sites: dict, taken: str
) -> None:
    """Elfin's file has a frame of a dummy gripper at its side."""
    text = ""
    for site, place in sites.items():
        text += f'<site name="{site}" pos="{place}"/>'
    assert find_gripper(hand(text)).fields["tcp_site"] == taken


def test_a_frame_that_is_not_between_the_fingers_is_named() -> None:
    both = FINGERS.format("left", 0.02) + FINGERS.format("right", -0.02)
    gripper = find_gripper(hand('<site name="tool0" pos="0 0 -.02"/>', both))
    assert (
        "between the ends of the gripper's fingers, where 'tool0' is not" in gripper.how
    )
    assert gripper.fields["tcp_position_m"][2] > 0.1


def test_a_frame_that_moves_with_a_finger_is_not_the_tools() -> None:
    left = FINGERS.format("left", 0.02).replace(
        "</body>", '<site name="fingertip" pos="0 0 .06"/></body>'
    )
    gripper = find_gripper(hand(fingers=left + FINGERS.format("right", -0.02)))
    assert gripper.fields["tcp_body"] == "link4"
    np.testing.assert_allclose(gripper.fields["tcp_position_m"][:2], 0, atol=1e-6)


def test_a_light_alone_is_no_tool() -> None:
    gripper = find_gripper(hand('<site name="gripper_led_frame" pos="0 0 .2"/>'))
    assert gripper.fields["tcp_body"] == "link4"


BESIDE = {
    "before it": ("0 0 .06", "0 0 0", [0, 0, 1]),
    "to one side": (".03 0 .06", "0 0 0", [0, 0, 1]),
    "to the other side": ("-.03 0 .06", "0 0 0", [0, 0, 1]),
    "to one side, turned by a right angle": (".06 0 .02", "0 1.5708 0", [0, 0, 1]),
    "turned a little": ("0 0 .06", "0 .2 0", [0, 0, 1]),
    "in a frame of its own": ("0 0 .06", ".3 .2 .4", None),
}
"""Place and turn of a hand on a wrist that does not roll; where it points, in its own frame."""


@pytest.mark.parametrize("name", BESIDE)
def test_a_hand_beside_a_wrist_that_does_not_roll_points_as_its_frame(
    name: str,
) -> None:
    """The way from the wrist to the fingers of AgileX's Nero is 10 degrees off."""
    place, turn, points = BESIDE[name]
    text = change(
        (
            '<body name="l6" pos="0 0 .06"><joint name="j6" axis="0 0 1"/>',
            f'<body name="l6" pos="{place}" euler="{turn}">',
        )
    )
    gripper = find_gripper(mujoco.MjModel.from_xml_string(text))
    assert gripper.joints[-1] == "j5"
    w, x, y, z = gripper.fields["tcp_quaternion"]
    approach = [2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z]
    if points is None:
        assert np.abs(approach).max() < 0.999
    else:
        np.testing.assert_allclose(approach, points, atol=1e-4)
