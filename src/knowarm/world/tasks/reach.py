"""Reaching task (paper, section 3)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from knowarm.errors import Argument, UserError
from knowarm.world.robots.robot import Robot
from knowarm.world.tasks.task import Task


@dataclass(frozen=True, kw_only=True)
class Reach(Task):
    """Reach the grasp frame of the one visible object (paper, section 3)."""

    # The paper's experiment starts as its film strips do.
    training: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "a3c": {"env": {"task": {"start": "near"}}}
    }

    kind: Literal["reach"] = "reach"
    """Tag of this task in JSON."""
    start: Literal["far", "near"] = "far"
    """Where the gripper starts: far from every grasp, so that a fixed list of actions seldom
    succeeds, or as in the paper's film strips, 5 to 7 steps from the object. Near takes start
    pose, MPI and yaws of the robot's area "near"."""

    @property
    def title(self) -> str:
        """No words: this is the paper's task."""
        return ""

    def area_of(self, robot: Robot) -> str:
        """Name the area of the start; a robot without a near start is refused."""
        if self.start == "far":
            return self.area
        if self.start not in robot.areas:
            raise UserError(
                f"Robot {robot.name!r} has no near start. Describe it as [areas.near] in the TOML "
                "file of your own robot, or take ",
                Argument("env.task.start", "far"),
                ".",
            )
        return self.start
