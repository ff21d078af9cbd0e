"""Repair of a draft whose path to the grasps fails its checks: what was tried, and what helped."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from knowarm.errors import UserError
from knowarm.own_robot.draft import Draft, written
from knowarm.own_robot.draft_reach import YAWS_DEG
from knowarm.own_robot.poses import Fields, rounded
from knowarm.own_robot.robot_check import check_ways
from knowarm.world.config import EnvConfig

LARGER = (1.25, 1.5)  # Times the drafted largest step
SMALLER = (0.8, 0.6)  # Times the drafted rectangle
MOST_STEP = 0.15  # Largest step that is tried [rad]


def repair_draft(draft: Draft, targets: Sequence[str], given: Fields) -> Draft:
    """Change a draft until every target is reached in time, or say what was tried.

    ``given`` are the fields that the user has set, which stay.
    """
    failed = _failed(draft, targets, {})
    if not failed:
        return draft
    names = ", ".join(failed)
    tried = []
    for changes in _changes(draft, targets, failed):
        if given.keys() & changes.keys():
            continue
        tried.append(", ".join(f"{name} = {value}" for name, value in changes.items()))
        if not _failed(draft, targets, changes):
            fields = draft.fields | changes
            how = draft.how | {"repair": f"{tried[-1]}, as these failed: {names}"}
            robot = replace(draft.robot, **changes)
            return replace(draft, fields=fields, how=how, robot=robot)
    text = f"none, {names} failed also with {'; '.join(tried) or 'nothing else to try'}"
    return replace(draft, how=draft.how | {"repair": text})


def _changes(
    draft: Draft, targets: Sequence[str], failed: Sequence[str]
) -> Iterator[Fields]:
    """Yield fields to try: larger steps, other directions of what fails, smaller rectangles."""
    robot = draft.robot
    larger = []
    for factor in LARGER:
        step = round(factor * robot.mpi_rad, 3)
        if step <= MOST_STEP:
            larger.append({"mpi_rad": step})
    yield from larger
    yaws = dict(robot.target_yaws_deg)
    for name in targets:
        if f"reach of {name}" in failed:
            for yaw in YAWS_DEG:
                if yaw != robot.yaw_deg(name):
                    yield {"target_yaws_deg": yaws | {name: yaw}}
    steps: list[Fields] = [{}, *larger]
    half = np.array(robot.rectangle_half_size_m)
    for factor, faster in product(SMALLER, steps):
        yield {"rectangle_half_size_m": rounded(factor * half), **faster}


def _failed(draft: Draft, targets: Sequence[str], changes: Fields) -> list[str]:
    """Return the names of the checks that a draft with changes fails."""
    with written(draft, **changes) as file:
        try:
            config = EnvConfig(robot=file, targets=tuple(targets))
            return [check.name for check in check_ways(config) if not check.ok]
        except UserError:  # such as a grasp outside the image
            return ["scene"]
