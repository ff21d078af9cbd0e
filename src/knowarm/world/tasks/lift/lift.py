"""Lifting task: close the fingers at the grasp frame of a solid object and lift it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from knowarm.config import above_zero, at_least
from knowarm.world.backend import Dynamics
from knowarm.world.objects.target import Target
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.lift.model import LiftScene, build_lift_scene
from knowarm.world.tasks.lift.simulator import LiftSimulator
from knowarm.world.tasks.lift.teacher import LiftTeacher
from knowarm.world.tasks.reward import SUCCESS_REWARD
from knowarm.world.tasks.state import EpisodeState
from knowarm.world.tasks.task import Task

State = EpisodeState[LiftSimulator]

GRIP_REWARD, RISE_REWARD = 1.0, 4.0
LOST_M = 0.15  # Way of the object along the support after which an episode ends
FALLEN_M = 0.05  # Depth below its place after which an episode ends


@dataclass(frozen=True, kw_only=True)
class Lift(Task):
    """Lift the one visible object, which is solid, with fingers that move.

    The fingers are one more joint of the actions, its increments in metres per finger: level 1
    closes them by the maximum position increment.
    """

    area: ClassVar[str] = "lift"
    targets: ClassVar[tuple[str, ...]] = ("mug", "bottle")
    max_steps: ClassVar[int] = 100
    moves_fingers: ClassVar[bool] = True
    dynamics: ClassVar[tuple[str, ...]] = ("dynamic",)  # Kinematics have no contacts.
    training: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "distil": {
            "total_steps": 800_000,
            "algorithm": {"way_limit": 2.0, "stay_share": 0.2, "glimpse_until": 0.1},
        }
    }
    column_meanings: ClassVar[dict[str, str]] = {
        "rise_m": "rise of the object's centre of mass at the end [m]",
        "gripped": "whether both fingers touched it at the end",
    }

    kind: Literal["lift"] = "lift"
    """Tag of this task in JSON."""

    height_m: float = 0.08
    """Rise of the object's centre of mass from which it is lifted [m]."""

    hold_steps: int = 3
    """Consecutive steps at this height between both fingers that count as success."""

    def __post_init__(self) -> None:
        above_zero(self, "height_m", where="task.")
        at_least(self, 1, "hold_steps", where="task.")

    @staticmethod
    def build_scene(robot: Robot, targets: Sequence[Target], distractors: int) -> LiftScene:
        """Build a scene with fingers that move and objects that can be pushed and lifted."""
        return build_lift_scene(robot, targets, distractors)

    def simulator(
        self, scene: Scene, num_envs: int, num_threads: int, dynamics: Dynamics
    ) -> LiftSimulator:
        """Make the physics of n environments with contacts."""
        assert isinstance(scene, LiftScene)
        return LiftSimulator(scene, num_envs, num_threads)

    def joint_names(self, robot: Robot) -> tuple[str, ...]:
        """Name the joints of the arm and the fingers, which move together."""
        return (*robot.joints, "fingers")

    def teacher(self, state: State) -> LiftTeacher:
        """Make what approaches, closes the fingers and lifts."""
        return LiftTeacher(state)

    def guide(self, state: State, seed: int, straight: bool) -> LiftTeacher:
        """Make the teacher: there is no shorter way."""
        return self.teacher(state)

    def memory(self, num_envs: int) -> dict[str, NDArray[Any]]:
        """Remember for how many steps the object has been held up."""
        return {"held": np.zeros(num_envs, dtype=np.int64)}

    def remember(self, state: State) -> Mapping[str, NDArray[Any]]:
        """Count the step, or start again."""
        up = state.simulator.touched(state.target) & (_rise(state) >= self.height_m)
        return {"held": np.where(up, state.memory["held"] + 1, 0)}

    def success(self, state: State) -> NDArray[np.bool_]:
        """Return which objects were held up long enough, (n,) bool."""
        return np.asarray(state.memory["held"] >= self.hold_steps)

    def failure(self, state: State) -> NDArray[np.bool_]:
        """Return which objects were pushed 15 cm away or fell off their support, (n,) bool."""
        place = state.simulator.place(state.target)
        moved = np.linalg.norm(place - state.positions[:, 0], axis=1)
        lost = (moved > LOST_M) | (_rise(state) < -FALLEN_M)
        return np.asarray(lost & ~state.success)

    def reward(self, state: State) -> NDArray[np.float64]:
        """Compute the reward of a step, (n,).

        100 on success; otherwise, while both fingers touch the object, 1 + 4 min(h / height_m, 1)
        with h its rise; otherwise the paper's -2 d^2 - a / 70.
        """
        rise = (_rise(state) / self.height_m).clip(0.0, 1.0)
        held = GRIP_REWARD + RISE_REWARD * rise
        value = np.where(state.simulator.touched(state.target), held, super().reward(state))
        return np.asarray(np.where(state.success, SUCCESS_REWARD, value))

    def infos(self, state: State) -> dict[str, NDArray[Any]]:
        """Add the object's rise [m] and whether both fingers touch it."""
        gripped = state.simulator.touched(state.target)
        return super().infos(state) | {"rise": _rise(state), "gripped": gripped}

    def columns(self, setting: Any, infos: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Store rise and touch at the end of each episode."""
        return {"rise_m": infos["rise"], "gripped": infos["gripped"]}


def _rise(state: State) -> NDArray[np.float64]:
    return state.simulator.rise(state.target)
