"""Reaching (paper, section 3)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from knowarm.errors import Argument, UserError
from knowarm.world.robots.robot import Robot
from knowarm.world.tasks.asked.asked import Asking
from knowarm.world.tasks.skills.skill import Skill


@dataclass(frozen=True, kw_only=True)
class Reach(Skill):
    """Reach the grasp frame of the object that is meant (paper, section 3)."""

    kind: Literal["reach"] = "reach"
    """Tag of this skill in JSON."""
    start: Literal["far", "near"] = "far"
    """Where the gripper starts: far from every grasp, so that a fixed list of actions seldom
    succeeds, or as in the paper's film strips, 5 to 7 steps from the object. Near takes start
    pose, MPI and yaws of the robot's area "near"."""

    @property
    def title(self) -> str:
        """No words: this is the paper's."""
        return ""

    def check(self, asked: Asking) -> None:
        """Refuse a near start where what is asked decides the area."""
        if self.start != "far" and asked.area is not None:
            raise UserError(
                f"A near start is for one object of which nothing is asked, got {asked.kind!r}. "
                "Take ",
                Argument("env.task.skill.start", "far"),
                ".",
            )

    def training(self, algorithm: str, asked: Asking) -> Mapping[str, Any]:
        """Start the paper's experiment as its film strips do."""
        near = {"env": {"task": {"skill": {"start": "near"}}}}
        fields = {"a3c": near} if asked.area is None else {}
        return fields.get(algorithm, {})

    def area_of(self, robot: Robot) -> str:
        """Name the area of the start; a robot without a near start is refused."""
        if self.start == "far":
            return self.area
        if self.start not in robot.areas:
            raise UserError(
                f"Robot {robot.name!r} has no near start. Describe it as [areas.near] in the TOML "
                "file of your own robot, or take ",
                Argument("env.task.skill.start", "far"),
                ".",
            )
        return self.start
