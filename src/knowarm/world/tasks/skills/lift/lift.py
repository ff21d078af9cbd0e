"""Lifting: close the fingers at the grasp frame of a solid object and lift it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.linalg import norm

from knowarm.arrays import Floats, Integers, Mask
from knowarm.config import check_values
from knowarm.errors import UserError
from knowarm.ranges import LEAST, within
from knowarm.world.backend import Dynamics
from knowarm.world.objects.target import Target
from knowarm.world.robots import ROBOTS
from knowarm.world.robots.robot import FINGERS_JOINT, Robot
from knowarm.world.scene.scene import Scene, target_places
from knowarm.world.tasks.asked.asked import Asking
from knowarm.world.tasks.probe import BaseProbe
from knowarm.world.tasks.reward import SUCCESS_REWARD
from knowarm.world.tasks.skills.lift.guide import LiftGuide
from knowarm.world.tasks.skills.lift.model import LiftScene, build_lift_scene
from knowarm.world.tasks.skills.lift.probe import LiftProbe
from knowarm.world.tasks.skills.lift.simulator import LiftSimulator
from knowarm.world.tasks.skills.lift.teacher import LiftTeacher
from knowarm.world.tasks.skills.skill import Skill
from knowarm.world.tasks.state import EpisodeState, NamedArrays

State = EpisodeState[LiftSimulator]

GRIP_REWARD = 1.0
RISE_REWARD = 4.0
LOST_M = 0.15  # Way of the object along the support after which an episode ends
DISTURBED_M = (
    0.03  # Way of the centre of mass of another object after which it ends too
)
FALLEN_M = 0.05  # Depth below its place after which an episode ends
UNSTABLE_PHYSICS = "the physics became unstable."

# Size of a drafted area relative to the rectangle: that of shipped robots
SHARE = (0.25, 0.75)
STEP_M = 0.018
"""Way of the gripper by the largest step of the first joint in a drafted area. A gripper of larger
steps stops beside its grasp; one of smaller steps is slow, and objects turn in its grip."""

TURNS: tuple[dict[str, float], ...] = (
    {},
    {"target_yaw_deg": 180.0},
    {"target_yaw_deg": -135.0},
    {"target_yaw_deg": 135.0},
)
"""Directions of the objects in a drafted area, first those of the rectangle."""


@dataclass(frozen=True, kw_only=True)
class Lift(Skill):
    """Lift the object that is meant. Objects are solid, and the fingers move.

    The fingers are one more joint of the actions, its increments in metres per finger: level 1
    closes them by the maximum position increment.
    """

    area = "lift"
    targets: ClassVar[tuple[str, ...]] = ("mug", "bottle")
    max_steps = 100
    moves_fingers = True
    simulator_class: ClassVar[type[LiftSimulator]] = LiftSimulator
    """Simulator of the skill's physics."""
    dynamics = ("dynamic",)  # Kinematics have no contacts.
    column_meanings: ClassVar[dict[str, str]] = {
        "rise_m": "rise of the object's centre of mass at the end [m]",
        "gripped": "whether both fingers touched it at the end",
        "disturbed": "whether another object had moved by 3 cm at the end",
    }

    probes: ClassVar[tuple[type[BaseProbe], ...]] = (LiftProbe,)

    kind: Literal["lift"] = "lift"
    """Tag of this skill in JSON."""

    height_m: float = 0.08
    """Rise of the object's centre of mass from which it is lifted [m]."""

    hold_steps: int = 3
    """Consecutive steps at this height between both fingers that count as success."""

    def __post_init__(self) -> None:
        check_values(self, where="task")
        within(self, LEAST, 1.0, "height_m", where="task.")

    def check(self, asked: Asking) -> None:
        """Refuse parts: a solid object is one target."""
        if asked.shares_places:
            raise UserError(
                f"Whole objects are lifted, and {asked.kind!r} asks for parts of them. Reach them, "
                "or ask for something else."
            )

    def suits(self, target: str) -> bool:
        """Return whether all shipped grippers can lift an object."""
        return not any(target in robot.cannot_hold for robot in ROBOTS.values())

    def training(self, algorithm: str, asked: Asking) -> Mapping[str, Any]:
        """Imitate for longer, with a teacher that lets the student make larger detours."""
        limits = {"way_limit": 2.0, "stay_share": 0.2, "glimpse_until": 0.1}
        fields = {"distil": {"total_steps": 800_000, "algorithm": limits}}
        return fields.get(algorithm, {})

    def areas_to_try(self, robot: Robot) -> Iterator[dict[str, Any]]:
        """Yield the middle of the rectangle, with the objects turned in several directions."""
        radius = float(norm(robot.rectangle_centre_m))
        area = {
            "centre_m": list(robot.rectangle_centre_m),
            "half_size_m": np.round(
                np.multiply(SHARE, robot.rectangle_half_size_m), 3
            ).tolist(),
            "mpi_rad": round(min(robot.mpi_rad, STEP_M / radius), 3),
        }
        for turned in TURNS:
            yield area | turned

    @classmethod
    def build_scene(
        cls, robot: Robot, targets: Sequence[Target], distractors: int
    ) -> LiftScene:
        """Build a scene with fingers that move and objects that can be pushed and lifted."""
        return build_lift_scene(robot, targets, distractors)

    def simulator(
        self, scene: Scene, num_envs: int, num_threads: int, dynamics: Dynamics
    ) -> LiftSimulator:
        """Make the physics of n environments with contacts."""
        assert isinstance(scene, LiftScene)
        return self.simulator_class(scene, num_envs, num_threads)

    def joint_names(self, robot: Robot) -> tuple[str, ...]:
        """Name the joints of the arm and the fingers, which move together."""
        return (*robot.joints, FINGERS_JOINT)

    def teacher(self, state: State) -> LiftTeacher:
        """Make what approaches, closes the fingers and lifts."""
        return LiftTeacher(state)

    def guide(self, straight: bool) -> type[LiftGuide]:
        """Return what finds a path between other objects; all end straight."""
        return LiftGuide

    def memory(self, num_envs: int) -> NamedArrays:
        """Remember for how many steps the object has been held up."""
        return {"held": np.zeros(num_envs, np.int64)}

    def remember(self, state: State) -> NamedArrays:
        """Count the step, or start again."""
        is_up = self._is_up(state, state.target)
        return {"held": np.where(is_up, state.memory["held"] + 1, 0)}

    def grasp_positions(self, state: State) -> Floats:
        """Return the grasp points of the visible objects where these are now, (n, m, 3) [m]."""
        simulator = state.simulator
        points = []
        for objects in state.objects.T:
            point = target_places(state.scene, simulator.place(objects))
            point += state.scene.grasp_position[objects]
            point[:, 2] += simulator.rise(objects)
            points.append(point)
        return np.stack(points, axis=1)

    def done_to(self, state: State, which: Integers) -> Mask:
        """Return which visible objects (n,) are lifted, (n,) bool."""
        return self._is_up(state, state.objects[np.arange(len(which)), which])

    def success(self, state: State) -> Mask:
        """Return which objects were held up long enough, with no other one disturbed, (n,) bool."""
        return (state.memory["held"] >= self.hold_steps) & ~disturbed(state)

    def failure(self, state: State) -> Mask:
        """Return which episodes are lost, (n,) bool.

        Those whose object was pushed 15 cm away or fell off its support, those in which another one
        was moved by 3 cm, lifted or toppled, and those whose physics became unstable.
        """
        place = state.simulator.place(state.target)
        moved = norm(place - state.positions[:, 0], axis=1)
        is_lost = (moved > LOST_M) | (_rise(state) < -FALLEN_M)
        is_spoiled = disturbed(state) | state.simulator.unstable
        return (is_lost & ~state.success) | is_spoiled

    def reward(self, state: State) -> Floats:
        """Compute the reward of a step, (n,).

        100 on success; otherwise, while both fingers touch the object, 1 + 4 min(h / height_m, 1)
        with h its rise; otherwise the paper's -2 d^2 - a / 70.
        """
        rise = (_rise(state) / self.height_m).clip(0.0, 1.0)
        held = GRIP_REWARD + RISE_REWARD * rise
        value = np.where(
            state.simulator.touched(state.target), held, super().reward(state)
        )
        return np.where(state.success, SUCCESS_REWARD, value)

    def infos(self, state: State) -> NamedArrays:
        """Add rise [m], touch of both fingers, whether others moved and physics was unstable."""
        gripped = state.simulator.touched(state.target)
        return {
            "rise": _rise(state),
            "gripped": gripped,
            "disturbed": disturbed(state),
            "unstable": state.simulator.unstable,
        }

    def result(self, state: State, asked: Asking, env_id: int) -> str:
        """Say whether it was lifted."""
        if state.success[env_id]:
            return "It is lifted."
        if state.simulator.unstable[env_id]:
            return f"It is not lifted: {UNSTABLE_PHYSICS}"
        if disturbed(state)[env_id]:
            return "It is not lifted: another object was moved."
        return "It is not lifted."

    def columns(self, setting: Any, infos: NamedArrays) -> NamedArrays:
        """Store rise, touch and what was disturbed at the end of each episode."""
        names = {"rise": "rise_m", "gripped": "gripped", "disturbed": "disturbed"}
        return {column: infos[name] for name, column in names.items()}

    def _is_up(self, state: State, objects: Integers) -> Mask:
        """Return which objects (n,) are at the height, with both fingers at them."""
        simulator = state.simulator
        is_high = simulator.rise(objects) >= self.height_m
        return simulator.touched(objects) & is_high & ~simulator.unstable


def _rise(state: State) -> Floats:
    return state.simulator.rise(state.target)


def disturbed(state: State) -> Mask:
    """Return in which episodes an object that is not meant has moved, (n,) bool.

    Where the physics became unstable, nothing counts as moved.
    """
    is_disturbed = np.zeros(len(state.steps), bool)
    for which in range(1, state.objects.shape[1]):
        objects = state.objects[:, which]
        moved = state.simulator.displacement(objects, state.positions[:, which])
        is_disturbed |= moved > DISTURBED_M
    return is_disturbed & ~state.simulator.unstable
