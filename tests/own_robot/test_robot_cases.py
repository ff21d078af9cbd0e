"""Robots as users have them: what is found of each, and what is refused, by its cause."""

import warnings
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.own_robot import draft, object_check
from knowarm.own_robot.draft import draft_robot, shrink_distance
from knowarm.own_robot.robot_check import check_joints, check_robot
from knowarm.own_robot.servo_check import check_servos
from knowarm.world.objects import find_targets
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.scene import build_scene
from knowarm.world.tasks.skills.lift.lift import Lift
from knowarm.world.tasks.skills.lift.model import build_lift_scene
from tests.own_robot.robot_cases import CASES
from tests.thorough import thorough
from tests.world.helpers import EXAMPLES

pytestmark = pytest.mark.usefixtures("unfenced")

SIX = "j1, j2, j3, j4, j5, j6; left out: {}; TCP: between the ends"
BASE = "base: turned or shifted"
FOUND = {
    "gripper hinge named joint7": SIX.format("joint7"),
    "finger named drive joint": SIX.format("drive_joint, other"),
    "one moving jaw": SIX.format("left"),
    "two arms": 'another arm: joints = ["rj1", "rj2", "rj3", "rj4", "rj5", "rj6"]; TCP',
    "waist, head and arm": SIX.format("w1, w2, neck, left, right"),
    "mobile base": SIX.format("x, y, turn, left, right"),
    "faces -y": BASE,
    "base away from the origin": BASE,
    "free base": BASE,
    "own table and cube": SIX.format("unnamed free joint of body 'cube5', left, right"),
    "loose cubes": "unnamed free joint of body 'cube1', unnamed free joint of body 'cube3', left",
    "unnamed joint": "j1, j2, j4, j5, j6; left out: unnamed hinge joint of body 'l3', left, right;",
    "all joints unnamed": "no chain of at least two named",
    "names with space, slash, umlaut": "up to body '\"6\"', where 2 moving parts begin: Gelenk 1",
    "zero inertia": "does not compile: Error: mass and inertia of moving bodies",
    "missing mesh": "does not compile: Error: Error opening file",
    "ball joint": "j1, j2, j3, j5, j6; left out: j4, left, right;",
    "two joints in one body": "j1, j2, j2b, j3",
    "site with z backward": "TCP: the place of site 'tcp', turned",
    "in centimetres": "m from joint 'j1', which no arm does",
}
"""What the draft says of a case; of others what it says of the plain arm."""


def lay_out(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, **given
) -> tuple:
    """Draft a case up to the search of a layout; return the error, and the scene it starts at."""
    scenes = []

    def stop(scene_at, heights, overrides):
        scenes.append(scene_at(heights[0]))
        raise UserError("Enough.")

    monkeypatch.setattr(draft, "find_layout", stop)
    (tmp_path / "arm.xml").write_text(CASES[name])
    warnings.simplefilter("error")
    with pytest.raises(UserError) as caught:
        draft_robot(tmp_path / "arm.xml", ["mug"], given)
    return str(caught.value), *scenes


@pytest.mark.parametrize("name", CASES)
def test_what_the_draft_finds(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    error = lay_out(name, tmp_path, monkeypatch)[0]
    assert FOUND.get(name, SIX.format("left, right")) in error
    placed = FOUND.get(name) == BASE or name.startswith("waist")
    assert (BASE in error) is placed


@pytest.mark.parametrize(
    ("name", "yaw_deg", "position"),
    [
        ("faces -y", 90.0, [0, 0, 0]),
        ("base away from the origin", 0.0, [0.47, 0, 0]),
        ("free base", 0.0, [0, 0, -1.5]),
    ],
)
def test_the_arm_is_turned_to_x_and_put_at_the_origin(
    name: str,
    yaw_deg: float,
    position: list,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = lay_out(name, tmp_path, monkeypatch)[1].robot
    assert abs(robot.base_yaw_deg) == yaw_deg
    np.testing.assert_allclose(robot.base_position_m, position, atol=0.06)


def test_only_what_hangs_is_lowered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def heights(name: str) -> list[float]:
        tried: list[float] = []

        def stop(scene_at, heights, overrides):
            tried.extend(heights)
            raise UserError("Enough.")

        monkeypatch.setattr(draft, "find_layout", stop)
        (tmp_path / "arm.xml").write_text(CASES[name])
        with pytest.raises(UserError, match="Enough"):
            draft_robot(tmp_path / "arm.xml", ["mug"], {})
        return tried

    assert heights("plain") == [0, 0.2, 0.4, 0.6]
    assert heights("on the ceiling") == [0, 0.2, 0.4, 0.6, -0.2, -0.4, -0.6]


def test_another_arm_is_taken_by_its_joints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    joints = [f"rj{i}" for i in range(1, 7)]
    error, scene = lay_out("two arms", tmp_path, monkeypatch, joints=joints)
    assert scene.robot.tcp_body == "rl6"
    assert scene.robot.fingers == ("rleft", "rright")
    assert "the given joints end" in error
    with pytest.raises(UserError, match="Did you mean 'rj6'"):
        draft_robot(tmp_path / "arm.xml", ["mug"], {"joints": ["rj", "rj2"]})


def test_ranges_of_actuators_and_what_has_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = lay_out("no ranges", tmp_path, monkeypatch)[1]
    assert scene.joint_upper[0] == 2.0
    found = check_joints(scene).found
    assert found.startswith("j1 [-2.00, 2.00], ")
    assert "j4 [-6.28, 6.28] (no range in the file)" in found


def test_coupled_joints_fail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check = check_joints(lay_out("coupled joints", tmp_path, monkeypatch)[1])
    assert not check.ok
    assert check.found.endswith("coupled in the file, not in the scene: j3 and j2")


@pytest.mark.parametrize(
    ("name", "hertz", "ok", "words"),
    [
        ("force limits", 7.0, True, ""),
        ("strong friction", 7.0, True, ""),
        ("tiny inertia", 7.0, True, ""),
        ("springs", 7.0, False, "stiffness of j1, j2, j3, j4, j5, j6"),
        ("plain", 0.5, False, "servo_frequency_hz = 5.0 gives 0.0"),
    ],
)
def test_servos_hold_the_joints_or_the_remedy_was_tried(
    name: str,
    hertz: float,
    ok: bool,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = lay_out(name, tmp_path, monkeypatch)[1].robot
    home = (0.0, 0.3, 0.9, 0.0, 0.9, 0.0)
    changed: Robot = replace(robot, servo_frequency_hz=hertz, home=home)
    check = check_servos(build_scene(changed, find_targets(["mug"])))
    assert check.ok is ok
    assert words in check.remedy


def test_fingers_are_drafted_open_and_closed_ones_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = lay_out("fingers drawn closed", tmp_path, monkeypatch)[1].robot
    assert (robot.fingers, robot.held_joints) == (
        ("left", "right"),
        {"left": 0.03, "right": 0.03},
    )
    targets = find_targets(["mug"])
    model = build_lift_scene(robot, targets, 0).model
    for finger in ("left", "right"):
        own = np.flatnonzero(model.geom_bodyid == model.body(finger).id)
        (pad,) = own[model.geom_contype[own] != 0]
        # A box around the part of the finger that is near the TCP.
        assert model.geom_size[pad] == pytest.approx([0.01, 0.005, 0.019], abs=1e-3)
        assert model.geom_rgba[pad, 3] == 0
    assert model.jnt_range[model.joint("left").id, 1] == pytest.approx(0.03, abs=1e-3)
    with pytest.raises(
        UserError, match="touch where they are drawn; open them with held_joints"
    ):
        build_lift_scene(replace(robot, held_joints={}), targets, 0)


def test_the_area_of_lifting_is_the_one_in_which_the_teacher_lifts_most(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = replace(lay_out("plain", tmp_path, monkeypatch)[1].robot, mpi_rad=0.08)
    robot = replace(
        robot, rectangle_centre_m=(0.6, 0.0), rectangle_half_size_m=(0.1, 0.2)
    )
    described = (EXAMPLES / "scara.toml").read_text()
    drafted = Mock(robot=robot, toml=lambda file, areas: described)
    # Enough; the best of all
    trials = (
        ([0.4, 0.7, 0.95], -135.0),
        ([0.4, 0.7, 0.6, 0.5], 180.0),
    )
    for shares, yaw in trials:
        monkeypatch.setattr(draft, "oracle_success", Mock(side_effect=shares))
        area, text = draft.find_area(drafted, Lift())
        assert area == {
            "centre_m": [0.6, 0.0],
            "half_size_m": [0.025, 0.15],
            "mpi_rad": 0.03,
            "target_yaw_deg": yaw,
        }
        assert f"{100 * max(shares):.0f} %" in text

    for most in (0.0, 0.39):
        monkeypatch.setattr(draft, "oracle_success", Mock(return_value=most))
        area, text = draft.find_area(drafted, Lift())
        assert area == {}
        assert f"no area: the teacher succeeds in at most {100 * most:.0f} %" in text

    def refuse(config: object, agent: object) -> float:
        raise UserError("Fingers touch.")

    monkeypatch.setattr(draft, "oracle_success", refuse)
    assert draft.find_area(drafted, Lift()) == (
        {},
        "not possible: Fingers touch.",
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "waist, head and arm",
        "on the ceiling",
        "own floor",
        # Their parts have tests above: joints, base and servos.
        *thorough((), ("two arms", "faces -y", "free base", "force limits")),
    ],
)
def test_drafts_pass_all_checks(
    name: str, tmp_path: Path, short_search: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name != "own floor":  # the search takes most of the time
        monkeypatch.setattr(
            draft, "find_area", lambda *arguments: ({}, "not looked for")
        )
    monkeypatch.setattr(object_check, "EPISODES", thorough(20, 40))
    (tmp_path / "arm.xml").write_text(CASES[name])
    found = draft_robot(tmp_path / "arm.xml", ["mug", "bottle"], {})
    found = shrink_distance(found, ["mug", "bottle"])
    (tmp_path / "arm.toml").write_text(found.toml(tmp_path / "arm.toml"))
    angle, roll = found.success_angle_deg, found.ignore_roll
    options = {"angle_deg": angle, "ignore_roll": roll, "distance_m": found.distance_m}
    checks = [*check_robot(tmp_path / "arm.toml", ["mug", "bottle"], **options)]
    assert [check for check in checks if not check.ok] == []
    names = [check.name for check in checks]
    assert "without looking" in names
    assert ("lift by physics" in names) is (name == "own floor")
    assert ("the teacher succeeds" in found.how["lift"]) is (name == "own floor")
