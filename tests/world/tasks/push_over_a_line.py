"""A skill in one file outside the package: push the object that is meant over the middle line."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from knowarm.arrays import Floats, Mask
from knowarm.world.robots.robot import Robot
from knowarm.world.tasks.asked.asked import Asking
from knowarm.world.tasks.skills.guides import Guide, Sight
from knowarm.world.tasks.skills.lift.guide import Leg, LiftGuide, Surroundings
from knowarm.world.tasks.skills.lift.lift import Lift, State
from knowarm.world.tasks.state import NamedArrays

BEYOND_M = 0.02  # Way of the object's centre beyond the line
SURELY_M = 0.10  # Way of the gripper beyond it: objects turn in the grip
POSES = 8  # of the path over it


class PushGuide(LiftGuide):
    """Takes hold of the object as for lifting, and slides it to the other side of the line."""

    def _after_grip(
        self, sight: Sight, path: Floats, surroundings: Surroundings
    ) -> list[Leg]:
        grasp = path[:, -1]
        line = self._scene.robot.rectangle_centre_m[1]
        offset = line - sight.places[:, 0, 1]
        way = offset + np.sign(offset) * SURELY_M
        position, matrix = self._follower.pose(grasp)
        shifts = np.zeros((POSES, len(grasp), 3))
        shifts[:, :, 1] = np.linspace(0, 1, POSES + 1)[1:, None] * way
        points = self._follower.solve_path(position, matrix, grasp, shifts)
        return [self._moving(points, self._closed_m)]


@dataclass(frozen=True, kw_only=True)
class Push(Lift):
    """The object's centre of mass has to get to the other side of the rectangle's middle line."""

    kind: Literal["slide"] = "slide"  # type: ignore[assignment]

    def suits(self, target: str) -> bool:
        return True

    def training(self, algorithm: str, asked: Asking) -> Mapping[str, Any]:
        return {}

    def guide(self, straight: bool) -> type[Guide]:
        return PushGuide

    def area_of(self, robot: Robot) -> str:
        return self.area

    def memory(self, num_envs: int) -> NamedArrays:
        return {}

    def remember(self, state: State) -> NamedArrays:
        return {}

    def success(self, state: State) -> Mask:
        line = state.scene.robot.rectangle_centre_m[1]
        start = state.positions[:, 0, 1] - line
        now = state.simulator.centre(state.target)[:, 1] - line
        return now * np.sign(start) < -BEYOND_M

    def failure(self, state: State) -> Mask:
        return state.simulator.rise(state.target) < -0.05

    def done_to(self, state: State, which: Any) -> Mask:
        return np.zeros(len(which), bool)

    def reward(self, state: State) -> Floats:
        return np.where(state.success, 100.0, -state.distance)
