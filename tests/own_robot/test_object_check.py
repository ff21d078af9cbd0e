"""Checks of the objects of the choose task."""

from pathlib import Path

from knowarm.own_robot.object_check import check_objects
from tests.world.helpers import EXAMPLES


def test_objects_that_can_be_reached_and_told_apart_pass() -> None:
    checks = check_objects("irb120", "choose", ["mug", "can", "book", "bell"])
    assert [check for check in checks if not check.ok] == []
    assert {"reach of mug", "book in the image", "any two objects differ"} <= {
        check.name for check in checks
    }


def test_an_object_is_drawn_with_all_its_parts() -> None:
    parts = ["bottle.neck", "bottle.stopper", "clock.bell", "clock.rim"]
    checks = {check.name: check for check in check_objects("irb120", "purpose", parts)}
    assert [check for check in checks.values() if not check.ok] == []
    shown = {"bottle in the image", "clock in the image"}
    assert {f"reach of {part}" for part in parts} | shown < {*checks}
    assert "bottle and clock" in checks["any two objects differ"].found


def test_two_objects_of_one_shape_are_named(tmp_path: Path) -> None:
    for name in ("one", "other"):
        text = (EXAMPLES / "bowl.toml").read_text()
        mjcf = (EXAMPLES / "bowl.toml").parent / "bowl.xml"
        lines = [
            line for line in text.splitlines() if not line.startswith(("mjcf", "name"))
        ]
        (tmp_path / f"{name}.toml").write_text(
            "\n".join([f'name = "{name}"', f'mjcf = "{mjcf}"', *lines])
        )
    files = [str(tmp_path / f"{name}.toml") for name in ("one", "other")]
    checks = {
        check.name: check
        for check in check_objects("irb120", "choose", [*files, "can", "bell"])
    }
    assert not checks["any two objects differ"].ok
    assert "one and other" in checks["any two objects differ"].found


def test_a_scene_that_cannot_be_built_is_the_only_check() -> None:
    (check,) = check_objects("irb120", "choose", ["mug", "mugg", "can", "bell"])
    assert not check.ok
    assert "mugg" in check.found


def test_objects_to_lift_are_checked_without_fingers() -> None:
    checks = check_objects("irb120", "lift", ["mug", "bottle"])
    assert [check for check in checks if not check.ok] == []


def test_an_easier_orientation_is_that_of_the_check() -> None:
    options = {"success_angle_deg": 1e-12}
    checks = {
        c.name: c for c in check_objects("irb120", "lift", ["mug", "bottle"], **options)
    }
    assert not checks["reach of mug"].ok
