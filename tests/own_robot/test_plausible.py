"""Ranges that no arm has are questioned, soft limits taken, and tables kept off the targets."""

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.own_robot import draft
from knowarm.own_robot.draft import draft_robot, read_overrides
from knowarm.own_robot.plausible import fixed_parts_above
from knowarm.own_robot.robot_check import check_joints, check_robot
from knowarm.own_robot.urdf import as_mjcf
from knowarm.world.objects import find_targets
from knowarm.world.robots import ROBOTS
from knowarm.world.scene.scene import Scene, build_scene
from tests.own_robot.robot_cases import ARM, LIMIT, as_urdf, change

pytestmark = pytest.mark.usefixtures("unfenced")

SHIPPED = ROBOTS["irb120"]


class Enough(Exception):
    """Ends a draft before its search."""


def scene_of_draft(
    path: Path, monkeypatch: pytest.MonkeyPatch, **given: object
) -> tuple[Scene, list[float]]:
    """Draft up to the search; return its scene at the first height, and the heights."""
    scenes = []

    def stop(scene_at, heights, overrides):
        scenes.append((scene_at(heights[0]), list(heights)))
        raise Enough

    monkeypatch.setattr(draft, "find_layout", stop)
    with pytest.raises(Enough):
        draft_robot(path, ["mug"], given)
    return scenes[0]


@pytest.mark.parametrize(
    ("text", "words", "ranges"),
    [
        (
            change(('range="-2.9 2.9"', 'range="-10 10"')),
            "j1 [-10, 10] rad, j4 [-10, 10] rad",
            {"j1": [-3.14, 3.14], "j4": [-3.14, 3.14], "j6": [-3.14, 3.14]},
        ),
        (
            change(('range="-1.8 1.8"', 'range="-100 110"')),
            "j2 [-100, 110] rad",
            {"j2": [-1.7453, 1.9199]},
        ),
        (
            change(
                (
                    'name="j4" axis="0 0 1"',
                    'name="j4" type="slide" axis="0 0 1" range="0 600"',
                )
            ),
            "j4 [0, 600] m",
            {"j4": [0.0, 0.6]},
        ),
        (
            change(('name="j6" axis="0 0 1"', 'name="j6" axis="0 0 1" range="-2 9.5"')),
            "j6 [-2, 9.5] rad",
            {"j6": [-2.0, 3.14]},
        ),
    ],
)
def test_ranges_that_no_arm_has_are_refused_and_the_remedy_works(
    text: str,
    words: str,
    ranges: dict,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "arm.xml").write_text(text)
    with pytest.raises(UserError) as caught:
        draft_robot(tmp_path / "arm.xml", ["mug"], {})
    assert words in str(caught.value)
    (setting,) = re.findall("--set '(.*)'", str(caught.value))
    given = read_overrides([setting])
    assert given == {"joint_ranges": ranges}
    scene, _ = scene_of_draft(tmp_path / "arm.xml", monkeypatch, **given)
    for name, ends in ranges.items():
        j = scene.joint_names.index(name)
        assert [scene.joint_lower[j], scene.joint_upper[j]] == ends
    assert check_joints(scene).ok


def test_a_urdf_in_degrees_is_refused_and_the_remedy_makes_it_radians(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "arm.urdf").write_text(as_urdf(limit=LIMIT.format(-165, 165)))
    file, _ = as_mjcf(tmp_path / "arm.urdf", tmp_path / "out")
    with pytest.raises(UserError, match="Are these degrees or millimetres") as caught:
        draft_robot(file, ["mug"], {})
    (setting,) = re.findall("--set '(.*)'", str(caught.value))
    scene, _ = scene_of_draft(file, monkeypatch, **read_overrides([setting]))
    np.testing.assert_allclose(scene.joint_lower, np.radians(-165), atol=1e-4)
    np.testing.assert_allclose(scene.joint_upper, np.radians(165), atol=1e-4)


@pytest.mark.parametrize("degrees", [360, 400, 455, 539])
def test_wrists_that_turn_more_than_once_are_accepted(
    degrees: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit = np.radians(degrees)
    text = f'name="j6" axis="0 0 1" range="{-limit} {limit}"'
    (tmp_path / "arm.xml").write_text(change(('name="j6" axis="0 0 1"', text)))
    scene, _ = scene_of_draft(tmp_path / "arm.xml", monkeypatch)
    assert check_joints(scene).ok
    assert scene.joint_upper[-1] == pytest.approx(limit)


def test_a_description_with_wrong_ranges_fails_and_names_the_field(
    tmp_path: Path,
) -> None:
    (tmp_path / "arm.xml").write_text(ARM)
    robot = replace(SHIPPED, joint_ranges={"joint_1": (-165.0, 165.0)})
    robot = replace(robot, joint_ranges={robot.joints[0]: (-165.0, 165.0)})
    check = check_joints(build_scene(robot, find_targets(["mug"])))
    assert not check.ok
    ranges = tomllib.loads(check.remedy.rsplit(": ", 1)[1].rstrip("."))["joint_ranges"]
    assert ranges == {robot.joints[0]: [-2.8798, 2.8798]}
    corrected = {name: tuple(ends) for name, ends in ranges.items()}
    scene = build_scene(replace(robot, joint_ranges=corrected), find_targets(["mug"]))
    assert check_joints(scene).ok


def test_ranges_given_for_a_file_in_degrees_are_in_radians(tmp_path: Path) -> None:
    text = ARM.replace('angle="radian"', 'angle="degree"').replace(
        '"j1" axis="0 0 1"', '"j1" type="slide" axis="1 0 0" range="0 .2"'
    )
    (tmp_path / "arm.xml").write_text(text)
    robot = replace(
        SHIPPED,
        mjcf=tmp_path / "arm.xml",
        joints=("j1", "j2"),
        tcp_body="l6",
        tcp_site="tcp",
        home=(0.0, 0.0),
        start_joints=(0,),
        held_joints={},
        fingers=(),
        areas={},
        joint_ranges={"j1": (0.0, 0.1), "j2": (-1.0, 0.5)},
    )
    scene = build_scene(robot, find_targets(["mug"]))
    np.testing.assert_allclose(scene.joint_lower, [0, -1])
    np.testing.assert_allclose(scene.joint_upper, [0.1, 0.5])
    with pytest.raises(UserError, match=r"joint_ranges\.j1 is 1\.0 to 0\.0"):
        replace(robot, joint_ranges={"j1": (1.0, 0.0)})
    with pytest.raises(UserError, match="joint_ranges names 'j9'"):
        build_scene(
            replace(robot, joint_ranges={"j9": (0.0, 1.0)}), find_targets(["mug"])
        )


SOFT = '<safety_controller soft_lower_limit="{}" soft_upper_limit="{}" k_velocity="1"/>'


@pytest.mark.parametrize(
    ("soft", "ends", "named"),
    [
        (SOFT.format(-2.8, 2.7), [-2.8, 2.7], True),
        (SOFT.format(-3.2, 2.7), [-2.9, 2.7], True),
        (SOFT.format(-5, 5), [-2.9, 2.9], False),
        (SOFT.format(0, 0), [-2.9, 2.9], False),
        (SOFT.format(2, -2), [-2.9, 2.9], False),
        (SOFT.format(3, 4), [-2.9, 2.9], False),
        ('<safety_controller k_velocity="1"/>', [-2.9, 2.9], False),
        (
            '<safety_controller soft_upper_limit="1" k_velocity="1"/>',
            [-2.9, 2.9],
            False,
        ),
        ("", [-2.9, 2.9], False),
    ],
)
def test_soft_limits_come_first(
    soft: str, ends: list, named: bool, tmp_path: Path
) -> None:
    (tmp_path / "arm.urdf").write_text(as_urdf(limit=LIMIT.format(-2.9, 2.9) + soft))
    file, note = as_mjcf(tmp_path / "arm.urdf", tmp_path / "out")
    model = mujoco.MjModel.from_xml_path(str(file))
    np.testing.assert_allclose(model.jnt_range, [ends] * 6)
    assert ("soft limits taken for j1, j2" in note) is named


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        (LIMIT.format(2.9, -2.9), "'j1' .* has a lower limit of 2.9 and an upper one"),
        (LIMIT.format("-2,9", 2.9), "'j1' .*: lower is '-2,9', which is no number"),
        (LIMIT.format("nan", 2.9), "'j1' .*: lower is 'nan', which is no number"),
    ],
)
def test_limits_of_a_urdf_that_cannot_be_are_named(
    limit: str, words: str, tmp_path: Path
) -> None:
    (tmp_path / "arm.urdf").write_text(as_urdf(limit=limit))
    with pytest.raises(UserError, match=words):
        as_mjcf(tmp_path / "arm.urdf", tmp_path / "out")


def test_limits_of_zero_are_said_to_be_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "arm.urdf").write_text(as_urdf(limit=LIMIT.format(0, 0)))
    file, _ = as_mjcf(tmp_path / "arm.urdf", tmp_path / "out")
    check = check_joints(scene_of_draft(file, monkeypatch)[0])
    assert check.found.count("(no range in the file)") == 6


BOX = '<geom name="{}" type="box" size="{}" pos="{}"/>'
RAISED = ('<body name="base">', '<body name="base" pos="0 0 .4">')
TABLES = {
    "a wide box": BOX.format("slab", ".45 .35 .02", ".4 0 .38"),
    "a box named table": BOX.format("table_top", ".2 .2 .02", ".1 0 .38"),
    "a body": f'<body name="bench">{BOX.format("b", ".4 .2 .2", ".3 0 .2")}</body>',
    "a raised floor": '<geom name="floor" type="plane" size="2 2 .1" pos="0 0 .4"/>',
    "sunk into it": BOX.format("slab", ".45 .35 .05", ".4 0 .4"),
    "a box on its side": '<geom name="plate" type="box" size=".02 .45 .35" '
    'pos=".4 0 .38" euler="0 1.5708 0"/>',
    "of two parts": BOX.format("Desk", ".3 .2 .02", ".1 0 .38")
    + BOX.format("desk_leg_1", ".02 .02 .18", ".3 .1 .18"),
}
"""What a file has below an arm whose base is 40 cm above the floor."""


@pytest.mark.parametrize("name", TABLES)
def test_an_arm_on_a_table_of_its_file_stands_on_the_floor_without_it(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "arm.xml").write_text(
        change(RAISED, ("<worldbody>", f"<worldbody>{TABLES[name]}"))
    )
    scene, heights = scene_of_draft(tmp_path / "arm.xml", monkeypatch)
    np.testing.assert_allclose(scene.robot.base_position_m, [0, 0, -0.4], atol=1e-3)
    assert heights[0] == pytest.approx(-0.4, abs=1e-3)
    model = scene.model
    names = [model.geom(g).name for g in range(model.ngeom)]
    assert "robot/l1" not in names
    assert not [
        n for n in names if re.match("robot/(slab|table|b|plate|desk)", n, re.I)
    ]


def test_an_arm_on_its_pedestal_stays_where_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pedestal = BOX.format("pedestal", ".15 .15 .2", "0 0 .2")
    (tmp_path / "arm.xml").write_text(
        change(RAISED, ("<worldbody>", f"<worldbody>{pedestal}"))
    )
    scene, _ = scene_of_draft(tmp_path / "arm.xml", monkeypatch)
    assert scene.robot.base_position_m == (0, 0, 0)
    assert scene.model.geom("robot/pedestal").id > 0


STAND = '<body name="base_link">'


@pytest.mark.parametrize(
    ("part", "named"),
    [
        (BOX.format("slab", ".2 .2 .01", ".5 0 .1"), ["slab"]),
        (
            '<geom type="cylinder" size=".3 .01" pos=".5 0 .1"/>',
            ["a geom of body 'world'"],
        ),
        (BOX.format("gantry", ".2 .2 .01", ".5 0 1.5"), []),
        (BOX.format("behind", ".2 .2 .1", "-.5 0 .1"), []),
    ],
)
def test_what_stands_above_the_targets_fails(
    part: str, named: list, tmp_path: Path
) -> None:
    text = SHIPPED.mjcf.read_text()
    assert STAND in text
    (tmp_path / "arm.xml").write_text(text.replace(STAND, part + STAND))
    robot = replace(SHIPPED, mjcf=tmp_path / "arm.xml")
    scene = build_scene(robot, find_targets(["mug"]))
    assert fixed_parts_above(scene) == named


def test_the_check_names_what_stands_above_the_targets(tmp_path: Path) -> None:
    text = SHIPPED.mjcf.read_text()
    slab = BOX.format("slab", ".2 .2 .01", ".5 0 .1")
    (tmp_path / "arm.xml").write_text(text.replace(STAND, slab + STAND))
    shipped = SHIPPED.mjcf.with_suffix(".toml").read_text()
    shipped = re.sub("(?m)^mjcf = .*$", 'mjcf = "arm.xml"', shipped)
    (tmp_path / "arm.toml").write_text(shipped)
    check = next(check_robot(tmp_path / "arm.toml", ["mug"]))
    assert not check.ok
    assert check.found.endswith("above the targets' rectangle: slab")
    moved = text.replace(STAND, f"<body>{slab}</body>{STAND}")
    (tmp_path / "arm.xml").write_text(moved)
    assert next(check_robot(tmp_path / "arm.toml", ["mug"])).ok
