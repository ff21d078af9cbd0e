"""Areas of skills in which a drafted robot uses its fingers: those in which the oracle succeeds.

An area is kept by what the oracle does in it: what two fingers do with an object depends on their
contacts, which inverse kinematics does not see.
"""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from knowarm.errors import UserError
from knowarm.own_robot.object_check import MIN_ORACLE, oracle_success
from knowarm.own_robot.poses import Fields
from knowarm.world.config import EnvConfig
from knowarm.world.robots.robot import Robot
from knowarm.world.tasks.skills.skill import Skill
from knowarm.world.tasks.task import Task

ENOUGH = MIN_ORACLE + 0.1  # Success of the oracle from which no other area is tried


def find_area(
    robot: Robot, describe: Callable[..., str], skill: Skill
) -> tuple[Fields, str]:
    """Find the area, of those that a skill proposes, in which its oracle succeeds most often.

    ``describe`` returns the description as TOML for a file, with fields that are given. Return the
    fields of the area, empty if nothing can be done, and what was found.
    """
    best = 0.0
    best_area: Fields = {}
    with TemporaryDirectory() as folder:
        for number, area in enumerate(skill.areas_to_try(robot)):
            file = Path(folder) / f"{skill.area}{number}.toml"
            file.write_text(describe(file, areas={skill.area: area}), "utf-8")
            config = EnvConfig(robot=str(file), task=Task(skill=skill))
            try:
                success = oracle_success(config)
            except UserError as error:
                return {}, f"not possible: {error}"
            if success > best:
                best = success
                best_area = area
            if best >= ENOUGH:
                break
    if not best_area:
        return (
            {},
            "not possible: the oracle succeeds in none of the areas that were tried",
        )
    found = f"the oracle succeeds in {100 * best:.0f} % of the episodes in its area"
    return best_area, found
