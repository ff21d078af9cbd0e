"""Fingers: drafted at the end at which they are widest, and refused where they are drawn closed."""

import tomllib
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.own_robot.draft_gripper import find_gripper
from knowarm.own_robot.opening import check_fingers
from knowarm.own_robot.urdf import as_mjcf
from knowarm.world.objects import find_targets
from knowarm.world.robots import ROBOTS
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.scene import build_scene
from knowarm.world.tasks.skills.lift.model import SQUEEZE_M, build_lift_scene
from tests.own_robot.robot_cases import ARM, LEFT, RIGHT, as_urdf

pytestmark = pytest.mark.usefixtures("unfenced")

FINGER = """<body name="{0}" pos="0 {1} .06"><joint name="{0}" type="slide" axis="0 {2} 0" {3}/>
  <geom type="box" size=".01 .005 .03" pos="0 {4} 0"/></body>"""


def fingers(*both: tuple[float, float, str, float], more: str = "") -> str:
    """Return the plain arm with fingers of a place, an axis, a range and a geom's offset."""
    first, second = (
        FINGER.format(name, place, axis, limits and f'range="{limits}"', offset)
        for name, (place, axis, limits, offset) in zip(
            ("left", "right"), both, strict=True
        )
    )
    assert LEFT in ARM
    assert RIGHT in ARM
    text = ARM.replace(LEFT, first).replace(RIGHT, second)
    return text.replace(' range="-2.9 2.9"/></default>', "/></default>").replace(
        "</mujoco>", f"{more}</mujoco>"
    )


def coupled(multiplier: float) -> str:
    return (
        '<equality><joint joint1="right" joint2="left" polycoef="0 '
        f'{multiplier} 0 0 0"/></equality>'
    )


CASES = {
    "open at the upper end": (
        fingers((0.01, 1, "0 .03", 0), (-0.01, -1, "0 .03", 0)),
        (0.03, 0.03, 0.07),
    ),
    "open at 0": (
        fingers((0.04, 1, "-.03 0", 0), (-0.04, -1, "-.03 0", 0)),
        (0.0, 0.0, 0.07),
    ),
    "0 outside the range, where they overlap": (
        fingers((0.0, 1, ".02 .05", -0.006), (0.0, 1, "-.05 -.02", 0.006)),
        (0.05, -0.05, 0.078),
    ),
    "closed at 0, negative axis": (
        fingers((0.006, -1, "-.038 0", 0), (-0.006, -1, "0 .038", 0)),
        (-0.038, 0.038, 0.078),
    ),
    "drawn crossed at 0": (
        fingers((0.0, 1, ".012 .04", -0.008), (0.0, -1, ".012 .04", 0.008)),
        (0.04, 0.04, 0.054),
    ),
    "may pass through each other": (
        fingers((0.01, 1, "-.04 .02", 0), (-0.01, -1, "-.04 .02", 0)),
        (0.02, 0.02, 0.05),
    ),
    "follower without a range": (
        fingers((0.01, 1, "0 .04", 0), (-0.01, 1, "", 0), more=coupled(-1)),
        (0.04, -0.04, 0.09),
    ),
    "follower with a range that the leader's does not allow": (
        fingers((0.01, 1, "0 .02", 0), (-0.01, -1, "0 .08", 0), more=coupled(1)),
        (0.02, 0.02, 0.05),
    ),
    "leader second": (
        fingers((0.01, 1, "", 0), (-0.01, -1, "0 .03", 0)).replace(
            "</mujoco>",
            '<equality><joint joint1="left" joint2="right"/></equality></mujoco>',
        ),
        (0.03, 0.03, 0.07),
    ),
    "one side moves more": (
        fingers((0.01, 1, "0 .05", 0), (-0.01, -1, "0 .01", 0)),
        (0.05, 0.01, 0.07),
    ),
}
"""MJCF of a gripper, and the values of its joints and the gap [m] that are drafted."""


@pytest.mark.parametrize("name", CASES)
def test_fingers_are_drafted_where_they_are_widest(name: str) -> None:
    text, (left, right, gap) = CASES[name]
    gripper = find_gripper(mujoco.MjModel.from_xml_string(text))
    assert gripper.fields["fingers"] == ["left", "right"]
    held = gripper.fields["held_joints"]
    assert held == pytest.approx({"left": left, "right": right})
    assert gripper.how.endswith(f"left and right, open by {100 * gap:.1f} cm")


def test_fingers_without_any_range_are_said_to_be_none() -> None:
    text = fingers((0.03, 1, "", 0), (-0.03, -1, "", 0))
    gripper = find_gripper(mujoco.MjModel.from_xml_string(text))
    assert "fingers" not in gripper.fields
    assert gripper.how.endswith(
        "no fingers: left, right have no range with two ends across the hand"
    )


def test_the_tips_count_where_fingers_bend_towards_each_other() -> None:
    """The hull of a bent finger overlaps with the other's where their tips do not touch."""
    text, _ = CASES["open at the upper end"]
    root = '<geom type="box" size=".01 .03 .005" pos="0 0 -.06"/></body>'
    text = text.replace("</body>\n", root + "\n").replace(
        "</body><body", root + "<body"
    )
    gripper = find_gripper(mujoco.MjModel.from_xml_string(text))
    assert gripper.how.endswith("open by 7.0 cm")


def test_tips_of_bodies_of_their_own_are_the_fingers(tmp_path: Path) -> None:
    """Carriages that slide past each other carry the tips, as of a rack and a pinion."""
    text, _ = CASES["closed at 0, negative axis"]
    for name in ("left", "right"):
        rack = '<geom type="box" size=".01 .05 .005" pos="0 0 -.05"/>'
        tip = (
            f'<body name="tip_{name}" pos="0 0 .04">'
            '<geom type="box" size=".01 .005 .03"/></body>'
        )
        start = text.index(f'<body name="{name}"')
        end = text.index("</body>", start)
        geom = text.index("<geom", start)
        text = text[:geom] + rack + tip + text[end:]
    gripper = find_gripper(mujoco.MjModel.from_xml_string(text))
    assert gripper.fields["fingers"] == ["tip_left", "tip_right"]
    # The tips reach from 7 to 13 cm.
    assert 0.1 < gripper.fields["tcp_position_m"][2] < 0.13
    assert gripper.how.endswith("open by 7.8 cm")
    held = gripper.fields["held_joints"]
    assert check_fingers(describe(tmp_path, text, held)).ok
    closed = check_fingers(describe(tmp_path, text, {"left": 0.0, "right": 0.0}))
    assert "held_joints = { left = -0.038, right = 0.038 }" in closed.remedy


def test_fingers_that_overlap_at_all_ends_are_none(tmp_path: Path) -> None:
    text = fingers((0.0, 1, "0 .002", 0), (0.0, -1, "0 .002", 0))
    gripper = find_gripper(mujoco.MjModel.from_xml_string(text))
    assert "fingers" not in gripper.fields
    assert gripper.how.endswith("left and right overlap at all their ends")
    other, _ = CASES["closed at 0, negative axis"]
    robot = describe(tmp_path, other, {})
    (tmp_path / "arm.xml").write_text(text)
    check = check_fingers(replace(robot, held_joints={"left": 0.002, "right": 0.002}))
    assert not check.ok
    assert check.remedy == "Open them in the file, or with held_joints."


OLD = 'size=".01 .005 .03" pos="0 0 0"/></body>'
BOX = '<geom type="box" size="{}" pos="{}"/>'
EYE = BOX.format(".01 .01 .01", "0 {} .047")  # Reaches 2.7 cm beyond the tip
CARRIED = {
    "a camera on one finger": (f'<body name="eye">{EYE}</body>'.format(".02"), ""),
    "a camera in one finger's body": (EYE.format(".02"), ""),
    "a camera on each finger": (EYE.format(".02"), EYE.format("-.02")),
    "a camera that is only drawn": (
        EYE.format(".02").replace("<geom", '<geom contype="0"'),
        "",
    ),
    "a bent tip": (BOX.format(".01 .02 .003", "0 .015 .033"), ""),
    "a plate outside": (BOX.format(".01 .002 .02", "0 .03 0"), ""),
    "screws outside": (
        '<geom size=".004" pos="0 .009 .028"/>',
        '<geom size=".004" pos="0 -.009 .0"/>',
    ),
    "a lamp beside one finger": (BOX.format(".01 .005 .02", ".03 .012 .03"), ""),
    "a cable of 10 cm": (BOX.format(".002 .002 .05", "0 .012 .05"), ""),
    "covers outside": (
        BOX.format(".012 .002 .035", "0 .0075 .003"),
        BOX.format(".012 .002 .035", "0 -.0075 .003"),
    ),
    "a sensor behind one finger": (BOX.format(".02 .01 .01", "0 .02 -.03"), ""),
}
"""What a finger and the other carry, of which nothing meets where they close."""


@pytest.mark.parametrize("name", CARRIED)
def test_what_fingers_carry_moves_no_tool_centre_point(name: str) -> None:
    text, _ = CASES["open at the upper end"]
    plain = find_gripper(mujoco.MjModel.from_xml_string(text)).fields
    assert text.count(OLD) == 2
    first, second, third = text.split(OLD)
    left, right = (OLD.replace("</body>", more + "</body>") for more in CARRIED[name])
    text = first + left + second + right + third
    gripper = find_gripper(mujoco.MjModel.from_xml_string(text))
    assert gripper.fields["fingers"] == ["left", "right"]
    assert gripper.how.endswith("open by 7.0 cm")
    for field in ("tcp_position_m", "tcp_quaternion"):
        assert gripper.fields[field] == pytest.approx(plain[field], abs=0.002)


def test_rubber_on_the_tips_makes_the_opening_smaller() -> None:
    text, _ = CASES["open at the upper end"]
    plain = find_gripper(mujoco.MjModel.from_xml_string(text)).fields
    first, second, third = text.split(OLD)
    left = OLD.replace(
        "</body>", BOX.format(".01 .001 .015", "0 -.006 .015") + "</body>"
    )
    right = OLD.replace(
        "</body>", BOX.format(".01 .001 .015", "0 .006 .015") + "</body>"
    )
    text = first + left + second + right + third
    gripper = find_gripper(mujoco.MjModel.from_xml_string(text))
    assert gripper.how.endswith("open by 6.6 cm")
    expected = pytest.approx(plain["tcp_position_m"], abs=0.002)
    assert gripper.fields["tcp_position_m"] == expected


LINK_M = 0.04  # Of the links that carry a hinged finger
HINGED = """<body name="{0}_link" pos="0 {1} .04"><joint name="{0}" axis="{2} 0 0" {3}/>
  <geom type="box" size=".005 .003 .02" pos="0 0 .02"/>
  <body name="{0}_tip" pos="0 0 .04"><joint name="{0}_tip" axis="{2} 0 0" {4}/>
    <geom type="box" size=".01 .005 .03" pos="0 0 .03"/></body></body>"""
BAR = """<body name="{0}_bar" pos="0 {1} .06"><joint name="{0}_bar" axis="1 0 0" range="-1.5 1.5"/>
  <geom type="box" size=".005 .003 .02" pos="0 0 .02"/></body>"""
SPRING = 'range="-1 0" stiffness="1"'
FOLLOW = '<joint joint1="{}" joint2="{}" polycoef="0 {} 0 0 0"/>'
LOOP = '<connect body1="{0}_tip" body2="{0}_bar" anchor="0 {1} .02"/>'
TIPS = FOLLOW.format("left_tip", "left", -1) + FOLLOW.format("right_tip", "right", -1)
MOTOR = '<actuator><position joint="left"/></actuator>'
WIDE = 'range="-1.5 1.5"'


def hinged(
    left: tuple[str, str],
    right: tuple[str, str],
    equalities: str = "",
    *,
    bars: bool = False,
    more: str = "",
    out: int = -1,
) -> str:
    """Return the plain arm with two fingers on hinged links, 5 cm apart where all are 0.

    Both fingers have the ranges of their link and tip. The left one opens at negative angles, and
    the right one where ``out`` is the axis.
    """
    first = HINGED.format("left", 0.03, 1, *left)
    second = HINGED.format("right", -0.03, out, *right)
    if bars:
        first += BAR.format("left", 0.035)
        second += BAR.format("right", -0.035)
    text = ARM.replace(LEFT, first).replace(RIGHT, second)
    text = text.replace(' range="-2.9 2.9"/></default>', "/></default>")
    return text.replace(
        "</mujoco>", f"<equality>{equalities}</equality>{more}</mujoco>"
    )


CLOSES = 'range="-.3 .6"'
ALONG = FOLLOW.format("right", "left", 1)
HINGES = {
    "mimics of one joint": (
        hinged((CLOSES, WIDE), (WIDE, WIDE), ALONG + TIPS),
        (-0.3, -0.3),
    ),
    "the other one turns the other way": (
        hinged(
            (CLOSES, WIDE),
            (WIDE, WIDE),
            FOLLOW.format("right", "left", -1) + TIPS,
            out=1,
        ),
        (-0.3, 0.3),
    ),
    "followers without ranges": (
        hinged((CLOSES, ""), ("", ""), ALONG + TIPS),
        (-0.3, -0.3),
    ),
    "the leader is the right one": (
        hinged(("", ""), (CLOSES, ""), FOLLOW.format("left", "right", 1) + TIPS),
        (-0.3, -0.3),
    ),
    "two free links": (
        hinged((CLOSES, WIDE), ('range="-.2 .6"', WIDE), TIPS),
        (-0.3, -0.2),
    ),
    "drawn closed, open at the upper end": (
        hinged(('range="-.6 .3"', WIDE), (WIDE, WIDE), ALONG + TIPS)
        .replace('axis="1 0 0" range="-.6', 'axis="-1 0 0" range="-.6')
        .replace(
            FOLLOW.format("left_tip", "left", -1), FOLLOW.format("left_tip", "left", 1)
        )
        .replace(ALONG, FOLLOW.format("right", "left", -1)),
        (0.3, -0.3),
    ),
    "closed loops": (
        hinged(
            (CLOSES, WIDE),
            (WIDE, WIDE),
            ALONG + LOOP.format("left", ".005") + LOOP.format("right", "-.005"),
            bars=True,
        ),
        (-0.3, -0.3),
    ),
    "closed loops that no equality couples": (
        hinged(
            (CLOSES, WIDE),
            (CLOSES, WIDE),
            LOOP.format("left", ".005") + LOOP.format("right", "-.005"),
            bars=True,
        ),
        (-0.3, -0.3),
    ),
    "springs hold the tips": (
        hinged((CLOSES, SPRING), (WIDE, SPRING), ALONG, more=MOTOR),
        (-0.3, -0.3),
    ),
    "mimics with ranges of the other sign": (
        hinged((CLOSES, 'range="-.9 0"'), (WIDE, 'range="-.9 0"'), ALONG + TIPS),
        (-0.3, -0.3),
    ),
    "a follower whose range ends before": (
        hinged((CLOSES, WIDE), ('range="-.15 .6"', WIDE), ALONG + TIPS),
        (-0.15, -0.15),
    ),
}
"""MJCF of hinged grippers, and the angles at which their links are open [rad]."""


@pytest.mark.parametrize("name", HINGES)
def test_hinged_fingers_are_found_and_drafted_open(name: str, tmp_path: Path) -> None:
    text, (left, right) = HINGES[name]
    gripper = find_gripper(mujoco.MjModel.from_xml_string(text))
    assert gripper.fields["fingers"] == ["left_tip", "right_tip"]
    held = gripper.fields["held_joints"]
    assert [held["left"], held["right"]] == pytest.approx([left, right], abs=0.02)
    gap = float(gripper.how.rsplit("open by ", 1)[1].removesuffix(" cm")) / 100
    if not name.startswith("springs"):  # else the tips turn with their links
        ways = [LINK_M * np.sin(abs(held[side])) for side in ("left", "right")]
        assert gap == pytest.approx(0.05 + sum(ways), abs=0.001)
        # 3 cm after the ends of the links, and a tenth of the hand's length before
        ends = 0.04 + LINK_M * np.cos(max(held["left"], held["right"], key=abs)) + 0.06
        assert 0.8 * ends < gripper.fields["tcp_position_m"][2] < ends
    robot = describe(tmp_path, text, held)
    assert check_fingers(robot).ok
    closed = check_fingers(
        replace(robot, held_joints={"left": 0.6 if left < 0 else -0.6})
    )
    assert not closed.ok
    limits = build_lift_scene(robot, find_targets(["mug"]), 0).joint_upper
    near_m = 0.01 if name.startswith("springs") else 0.003
    assert limits[-1] == pytest.approx(gap / 2 + SQUEEZE_M, abs=near_m)


@pytest.mark.parametrize(
    ("height", "back"), [(0.135, LINK_M * (1 - np.cos(0.8))), (0.12, 0.0)]
)
def test_a_makers_frame_ahead_of_open_fingers_moves_back_with_them(
    height: float, back: float
) -> None:
    """Closing, the fingers reach 1.2 cm farther, where the frame is between them."""
    text = hinged(('range="-.8 0"', WIDE), (WIDE, WIDE), ALONG + TIPS)
    site = f'<site name="tcp" pos="0 0 {height}" euler="0 0 0"/><body name="left_link"'
    gripper = find_gripper(
        mujoco.MjModel.from_xml_string(text.replace('<body name="left_link"', site))
    )
    assert gripper.fields["fingers"] == ["left_tip", "right_tip"]
    if back:
        expected = pytest.approx((0, 0, height - back), abs=0.001)
        assert gripper.fields["tcp_position_m"] == expected
        assert (
            "1.2 cm before site 'tcp', as open fingers end before closed" in gripper.how
        )
    else:
        assert gripper.fields["tcp_site"] == "tcp"
        assert "tcp_position_m" not in gripper.fields


THIRD = HINGED.format("third", 0.03, 1, CLOSES, WIDE).replace(
    "0 0.03 .04", ".02 .03 .04"
)
NO_FINGERS = {
    "no mimic, as where loops are lost": (
        hinged((CLOSES, WIDE), (CLOSES, WIDE)),
        "4 joints move them that the file couples by no mimic or equality",
    ),
    "three fingers": (
        hinged(
            (CLOSES, WIDE),
            (WIDE, WIDE),
            ALONG
            + TIPS
            + FOLLOW.format("third", "left", 1)
            + FOLLOW.format("third_tip", "left", -1),
        ).replace(
            "</body></body></body></body></body></body></body></worldbody>",
            THIRD + "</body>" * 7 + "</worldbody>",
        ),
        "3 of them close, and a grip is of two",
    ),
    "one jaw": (
        ARM.replace(RIGHT, ""),
        "left moves alone across the hand, and drafts take two that do",
    ),
    "joints without ranges": (
        hinged(("", ""), ("", ""), ALONG + TIPS),
        "left, left_tip, right, right_tip have no range with two ends",
    ),
    "suction": (
        ARM.replace(
            LEFT, '<body name="vacuum_gripper"><geom size=".02" pos="0 0 .05"/></body>'
        ).replace(RIGHT, ""),
        "no fingers: it holds by suction",
    ),
    "a gripper of one piece": (
        ARM.replace(
            LEFT, '<body name="gripper"><geom size=".02" pos="0 0 .05"/></body>'
        ).replace(RIGHT, ""),
        "no fingers: its gripper has no joints in the file",
    ),
    "no names": (
        hinged((CLOSES, WIDE), (WIDE, WIDE), ALONG + TIPS).replace(
            ' name="left_tip" pos', " pos"
        ),
        "no fingers: their bodies have no names",
    ),
}
"""MJCF of grippers that cannot lift, and why."""


@pytest.mark.parametrize("name", NO_FINGERS)
def test_a_gripper_that_cannot_lift_is_named_in_one_line(name: str) -> None:
    text, reason = NO_FINGERS[name]
    gripper = find_gripper(mujoco.MjModel.from_xml_string(text))
    assert "fingers" not in gripper.fields
    assert reason in gripper.how
    assert "\n" not in gripper.how


@pytest.mark.parametrize(
    ("name", "z"), [("suction", 0.07), ("a gripper of one piece", 0.063)]
)
def test_a_tool_without_joints_has_its_centre_point_at_its_end(
    name: str, z: float
) -> None:
    text, _ = NO_FINGERS[name]
    gripper = find_gripper(mujoco.MjModel.from_xml_string(text))
    assert gripper.fields["tcp_position_m"] == pytest.approx((0, 0, z), abs=1e-6)
    assert "TCP: at the end of the gripper" in gripper.how


def test_fingers_that_open_by_metres_are_none() -> None:
    text = fingers((0.01, 1, "0 1", 0), (-0.01, -1, "0 1", 0))
    gripper = find_gripper(mujoco.MjModel.from_xml_string(text))
    assert "fingers" not in gripper.fields
    assert gripper.how.endswith("left and right open by 201.0 cm, as no gripper does")


def test_short_fingers_on_wide_carriages_are_as_open_as_their_tips() -> None:
    """Those of the AR4 are 2 cm long, and their carriages pass each other."""
    text = fingers((0.01, 1, "0 .014", 0), (-0.01, -1, "0 .014", 0))
    old = '<geom type="box" size=".01 .005 .03" pos="0 0 0"/>'
    assert text.count(old) == 2
    short = (
        '<geom type="box" size=".01 .003 .01" pos="0 0 .01"/>'
        '<geom type="box" size=".01 .025 .009" pos="0 0 -.011"/>'
    )
    gripper = find_gripper(mujoco.MjModel.from_xml_string(text.replace(old, short)))
    assert gripper.fields["held_joints"] == {"left": 0.014, "right": 0.014}
    assert gripper.how.endswith("open by 4.2 cm")


@pytest.mark.parametrize(
    "names", [("left", "lef"), ("gone", "right"), ("left", "world")]
)
def test_fingers_that_do_not_exist_fail_in_one_line(
    names: tuple[str, str], tmp_path: Path
) -> None:
    text, _ = CASES["open at the upper end"]
    robot = describe(tmp_path, text, {"left": 0.03, "right": 0.03})
    check = check_fingers(replace(robot, fingers=names))
    assert not check.ok
    assert check.found == f"{' and '.join(names)} of arm.xml"
    assert check.remedy == "Name two bodies with geoms, or two geoms."


URDF_FINGERS = {
    "overlap at 0, outside their range": (
        '<limit lower=".02" upper=".05" effort="9" velocity="1"/>',
        '<limit lower="-.05" upper="-.02" effort="9" velocity="1"/>',
        {"left": 0.05, "right": -0.05},
    ),
    "follower without a limit": (
        '<limit lower=".02" upper=".05" effort="9" velocity="1"/>',
        '<mimic joint="left" multiplier="-1"/>',
        {"left": 0.05, "right": -0.05},
    ),
}


@pytest.mark.parametrize("name", URDF_FINGERS)
def test_fingers_of_a_urdf_are_drafted_open(name: str, tmp_path: Path) -> None:
    left, right, held = URDF_FINGERS[name]
    (tmp_path / "arm.urdf").write_text(as_urdf(left, right))
    file, _ = as_mjcf(tmp_path / "arm.urdf", tmp_path / "out")
    gripper = find_gripper(mujoco.MjModel.from_xml_path(str(file)))
    assert gripper.fields["held_joints"] == pytest.approx(held)
    assert "open by 7.8 cm" in gripper.how


def describe(folder: Path, text: str, held: dict[str, float]) -> Robot:
    """Return a description of an arm with fingers that is complete but for a layout."""
    (folder / "arm.xml").write_text(text)
    gripper = find_gripper(mujoco.MjModel.from_xml_string(text))
    fields = {**gripper.fields, "held_joints": held}
    return replace(
        ROBOTS["irb120"],
        name="arm",
        mjcf=folder / "arm.xml",
        joints=gripper.joints,
        home=(0.0,) * 6,
        camera_position_m=(2.0, -2.0, 1.5),
        camera_fovy_deg=60.0,
        areas={},
        cannot_hold={},
        **fields,
    )


def test_closed_fingers_fail_and_the_remedy_opens_them(tmp_path: Path) -> None:
    text, _ = CASES["0 outside the range, where they overlap"]
    closed = describe(tmp_path, text, {"left": 0.02, "right": -0.02})
    check = check_fingers(closed)
    assert not check.ok
    assert check.found == (
        "left and right are drawn 1.8 cm apart, and 7.8 cm at the other end"
    )
    held = tomllib.loads(check.remedy.split(": ", 1)[1].rstrip("."))["held_joints"]
    opened = replace(closed, held_joints=held)
    assert check_fingers(opened).ok
    targets = find_targets(["mug"])
    limits = build_lift_scene(opened, targets, 0).joint_upper
    assert limits[-1] > 0.03


def test_where_they_touch_lifting_names_their_own_joints(tmp_path: Path) -> None:
    text, _ = CASES["closed at 0, negative axis"]
    robot = describe(tmp_path, text.replace(".006", ".005"), {"left": 0, "right": 0})
    message = "left of -0.038 to 0, right of 0 to 0.038"
    with pytest.raises(UserError, match=message):
        build_lift_scene(robot, find_targets(["mug"]), 0)


@pytest.mark.parametrize("name", ["irb120", "tiago"])
def test_fingers_of_shipped_robots_are_open(name: str) -> None:
    assert check_fingers(ROBOTS[name]).ok


def test_the_measured_gap_is_that_of_the_drawn_scene(tmp_path: Path) -> None:
    text, (left, right, gap) = CASES["one side moves more"]
    robot = describe(tmp_path, text, {"left": left, "right": right})
    assert f"drawn {100 * gap:.1f} cm" in check_fingers(robot).found
    scene = build_scene(robot, find_targets(["mug"]))
    data = scene.at(np.array(scene.home))
    ends = [data.body(f"robot/{side}").xpos[1] for side in ("left", "right")]
    assert ends[0] - ends[1] - 0.01 == pytest.approx(gap, abs=1e-6)
