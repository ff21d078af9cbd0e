"""Grasps by physics: an area in which nothing is lifted fails, whatever its poses are."""

import re
from dataclasses import replace

import pytest

from knowarm.own_robot import grasp_check
from knowarm.own_robot.grasp_check import check_grasps
from knowarm.world.robots import ROBOTS

pytestmark = pytest.mark.usefixtures("unfenced")


def test_a_gripper_lifts_in_its_area_and_not_from_thin_air(monkeypatch) -> None:
    monkeypatch.setattr(grasp_check, "PLACES", 6)
    robot = ROBOTS["tiago"]
    (check,) = check_grasps(robot, "tiago")
    assert check.name == "lift by physics"
    assert check.ok
    held = re.fullmatch(
        r"succeeds at (\d) of 6 places: on a planned path at \d, as the teacher does at \d",
        check.found,
    )
    assert held is not None
    assert int(held[1]) >= 5


def test_fingers_that_grasp_nothing_fail(monkeypatch, tmp_path) -> None:
    """The poses are reached, and the fingers close beside the object."""
    monkeypatch.setattr(grasp_check, "PLACES", 3)
    robot = ROBOTS["tiago"]
    model = robot.mjcf.read_text()
    site = re.search(r'<site name="tcp" pos="([^"]*)"', model)
    assert site is not None
    x, y, z = site[1].split()
    beside = site[0].replace(site[1], f"{float(x) + 0.12} {y} {z}")
    (tmp_path / "tiago.xml").write_text(model.replace(site[0], beside))
    file = tmp_path / "arm.toml"
    file.write_text(robot.mjcf.with_suffix(".toml").read_text())
    (check,) = check_grasps(robot, str(file))
    assert not check.ok
    assert "succeeds at 0 of 3 places" in check.found
    assert "areas.lift" in check.remedy


@pytest.mark.parametrize("changes", [{"fingers": ()}, {"areas": {}}])
def test_what_cannot_lift_is_not_asked_to(changes: dict) -> None:
    assert [*check_grasps(replace(ROBOTS["tiago"], **changes), "tiago")] == []
