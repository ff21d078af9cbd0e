"""Repair of drafts: larger steps, other directions, smaller rectangles, or what was tried."""

import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from knowarm.check import Check
from knowarm.own_robot import repair
from knowarm.own_robot.draft import Draft
from knowarm.own_robot.repair import repair_draft
from knowarm.own_robot.robot_check import check_ways
from knowarm.world.config import EnvConfig
from knowarm.world.robots import ROBOTS
from tests.own_robot.test_robot_check import result_of
from tests.world.helpers import EXAMPLES, write_robot

pytestmark = pytest.mark.usefixtures("unfenced")

FIELDS = {
    "rectangle_half_size_m": [0.1, 0.3],
    "mpi_rad": 0.08,
    "target_yaws_deg": {"mug": 90.0},
}


def drafted(robot: str = "irb120") -> Draft:
    fields = {
        **tomllib.loads(ROBOTS[robot].mjcf.with_suffix(".toml").read_text()),
        "name": "arm",
    }
    fields |= FIELDS
    described = ROBOTS[robot]
    described = replace(
        described,
        mpi_rad=0.08,
        rectangle_half_size_m=(0.1, 0.3),
        target_yaws_deg={"mug": 90.0},
    )
    return Draft(
        robot=described,
        fields=fields,
        how={"arm": "x"},
        success_angle_deg=15.0,
        ignore_roll=False,
        distance_m=0.1,
    )


def checks_that_pass(monkeypatch: pytest.MonkeyPatch, passes, name="reach of mug"):
    """Let the checks of ways fail until ``passes`` says otherwise; return what they saw."""
    seen = []

    def check(config: EnvConfig):
        values = tomllib.loads(Path(config.robot).read_text())
        seen.append(values)
        yield Check(name, bool(passes(values)), "")

    monkeypatch.setattr(repair, "check_ways", check)
    return seen


def test_a_draft_that_passes_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = checks_that_pass(monkeypatch, lambda values: True)
    draft = drafted()
    assert repair_draft(draft, ["mug"], {}) is draft
    assert len(seen) == 1


@pytest.mark.parametrize(
    ("passes", "changes"),
    [
        (lambda v: v["mpi_rad"] > 0.09, {"mpi_rad": 0.1}),
        (lambda v: v["mpi_rad"] > 0.11, {"mpi_rad": 0.12}),
        (
            lambda v: v["target_yaws_deg"]["mug"] == -135,
            {"target_yaws_deg": {"mug": -135.0}},
        ),
        (
            lambda v: v["rectangle_half_size_m"][1] < 0.25,
            {"rectangle_half_size_m": [0.08, 0.24]},
        ),
        (
            lambda v: v["rectangle_half_size_m"][0] < 0.1 and v["mpi_rad"] > 0.09,
            {"rectangle_half_size_m": [0.08, 0.24], "mpi_rad": 0.1},
        ),
    ],
)
def test_the_first_change_that_helps_is_taken_and_said(
    passes, changes: dict, monkeypatch: pytest.MonkeyPatch
) -> None:
    checks_that_pass(monkeypatch, passes)
    draft = repair_draft(drafted(), ["mug"], {})
    assert {name: draft.fields[name] for name in changes} == changes
    assert tomllib.loads(draft.toml())["mpi_rad"] == draft.robot.mpi_rad
    assert draft.how["repair"].endswith("as these failed: reach of mug")
    assert draft.how["arm"] == "x"


def test_what_was_tried_is_said_where_nothing_helps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen = checks_that_pass(monkeypatch, lambda values: False)
    draft = drafted()
    same = repair_draft(draft, ["mug"], {})
    assert same.fields == draft.fields
    assert same.how["repair"].startswith(
        "none, reach of mug failed also with mpi_rad = 0.1; mpi_rad = 0.12; target_yaws"
    )
    assert len(seen) == 1 + 2 + 4 + 6


def test_what_is_given_is_not_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = checks_that_pass(monkeypatch, lambda values: False, "way to the grasps")
    given = {"mpi_rad": 0.08, "rectangle_half_size_m": [0.1, 0.3]}
    draft = repair_draft(drafted(), ["mug"], given)
    assert len(seen) == 1
    assert draft.how["repair"].endswith("failed also with nothing else to try")


def test_slow_ways_fail_and_the_remedy_names_the_step_and_the_other_targets(
    tmp_path,
) -> None:
    robot = write_robot(tmp_path, mpi_rad="0.02")
    targets = ["bottle", str(EXAMPLES / "bowl.toml")]
    config = EnvConfig(robot=str(robot), targets=tuple(targets))
    assert not next(check_ways(config)).ok
    check = result_of("reach of bottle", robot, targets)
    assert "enlarge mpi_rad, which is 0.02" in check.remedy
    assert check.remedy.endswith(f"or leave it out: --targets {targets[1]}.")
