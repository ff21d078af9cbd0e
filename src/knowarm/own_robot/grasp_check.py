"""Check of skills by physics: whether what an area is for succeeds in it, at 25 places."""

from collections.abc import Iterator

import numpy as np

from knowarm.check import Check
from knowarm.errors import UserError
from knowarm.world.agents import OracleAgent
from knowarm.world.agents.play import play
from knowarm.world.agents.scripted import TeacherAgent
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.robots.robot import Robot
from knowarm.world.tasks.skills import SKILLS
from knowarm.world.tasks.skills.skill import Skill
from knowarm.world.tasks.task import Task

PLACES = 25
MIN_HELD = 0.5  # Least share of the places at which the oracle or the teacher succeeds
MIN_TAUGHT = 0.4  # Least success of the teacher in an area that is drafted


def area_skills(robot: Robot) -> Iterator[Skill]:
    """Yield the skills that propose areas of their own, such as lifting."""
    for kind in SKILLS.types():
        skill = kind()
        if any(skill.areas_to_try(robot)):
            yield skill


def check_grasps(robot: Robot, path: str) -> Iterator[Check]:
    """Play skills in the areas that a description has for them; ``path`` is its file or name."""
    for skill in area_skills(robot):
        if robot.fingers and skill.area in robot.areas:
            yield _check_skill(skill, path)


def _check_skill(skill: Skill, path: str) -> Check:
    """Let the oracle, which plans its path, and the teacher try a skill at the same places."""
    remedy = (
        f"move or shrink areas.{skill.area}, turn its objects with target_yaw_deg there, or leave "
        "it out, if only the pose is to be reached."
    )
    try:
        config = EnvConfig(robot=path, task=Task(skill=skill), image_size=1)
        env = ArmVectorEnv(config, PLACES)
        episodes = evaluation_episodes(config, PLACES, 2)
        planned = play(OracleAgent(env), env, episodes).success
        taught = play(TeacherAgent(env), env, episodes).success
    except UserError as error:
        return Check(f"{skill.area} by physics", False, str(error), remedy)
    held = planned | taught
    return Check(
        f"{skill.area} by physics",
        bool(held.mean() >= MIN_HELD),
        f"succeeds at {np.sum(held)} of {PLACES} places: on a planned path at {np.sum(planned)}, "
        f"as the teacher does at {np.sum(taught)}",
        f"Fewer than {100 * MIN_HELD:.0f} %: {remedy}",
    )
