"""Placing: take the solid object that is meant and put it down on a tray."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.linalg import norm

from knowarm.arrays import Array, Floats, Images, Indices, Integers, Mask
from knowarm.knowledge import KnowledgeGraph
from knowarm.world.objects.target import Target
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.asked.asked import Asking
from knowarm.world.tasks.reward import SUCCESS_REWARD, paper_reward
from knowarm.world.tasks.skills.guides import DESTINATION, Sight
from knowarm.world.tasks.skills.lift.lift import (
    FALLEN_M,
    LOST_M,
    UNSTABLE_PHYSICS,
    Lift,
    State,
    disturbed,
)
from knowarm.world.tasks.skills.lift.model import LiftScene, build_lift_scene
from knowarm.world.tasks.skills.lift.simulator import LiftSimulator
from knowarm.world.tasks.skills.place.guide import PlaceGuide
from knowarm.world.tasks.skills.place.teacher import PlaceTeacher
from knowarm.world.tasks.skills.place.tray import (
    DOWN_M,
    add_trays,
    centres_m,
    is_over,
)
from knowarm.world.tasks.state import NamedArrays

STILL_M = 0.001  # Largest way of the centre of mass in a step at rest
UPRIGHT_DEG = 15.0
TOPPLED_DEG = 45.0
HELD_REWARD = 5.0
IMITATION_STEPS = 1_000_000

OUTCOMES = ("placed", "beside", "fallen", "disturbed", "unstable", "unfinished")
"""How an episode ended: on the tray; put down beside it; toppled or fallen, by the arm or at the
tray; another object moved or taken; unstable physics; none of these within the time limit."""
RESULTS = (
    "It stands on the tray.",
    "It is put down beside the tray.",
    "It has toppled or fallen.",
    "Another object was moved.",
    UNSTABLE_PHYSICS.capitalize(),
    "It is not put down.",
)
"""The same in sentences."""
PLACED, BESIDE, FALLEN, DISTURBED, UNSTABLE, UNFINISHED = range(len(OUTCOMES))


class PlaceSimulator(LiftSimulator):
    """Physics of placing: also fingers that open take small steps."""

    def _may_grip(self, joint_targets: Floats) -> Mask:
        """Return where fingers are not fully open, (n,)."""
        return super()._may_grip(joint_targets) | (self.joint_positions[:, -1] > 0.001)


@dataclass(frozen=True, kw_only=True)
class Place(Lift):
    """Put the object that is meant down on the tray beside the others, where it stood upright.

    Actions and physics are those of lifting. The tray stands at the first of the robot's
    ``trays_m``.
    """

    max_steps = 160
    simulator_class = PlaceSimulator
    outcomes: ClassVar[tuple[str, ...]] = OUTCOMES
    """How an episode can end."""
    column_meanings: ClassVar[dict[str, str]] = {
        "placing": f"how the episode ended: {', '.join(OUTCOMES)}",
        "tray_distance_m": "from the object's centre of mass to the tray's centre [m]",
    }
    probes = ()
    kind: Literal["place"] = "place"  # type: ignore[assignment]
    """Tag of this skill in JSON."""
    height_m: float = 0.03
    """Rise of the object's centre of mass from which it is taken [m]."""
    hold_steps: int = 3
    """Consecutive steps at rest on the tray, released, that count as success."""

    def training(self, algorithm: str, asked: Asking) -> Mapping[str, Any]:
        """Imitate with the limits of lifting, for longer: episodes are twice as long."""
        fields = dict(super().training(algorithm, asked))
        if fields:
            fields["total_steps"] = IMITATION_STEPS
        return fields

    def areas_to_try(self, robot: Robot) -> Iterator[dict[str, Any]]:
        """Propose none: that of lifting is taken."""
        return iter(())

    @staticmethod
    def tray_centres(robot: Robot) -> Floats:
        """Return x and y of the centres of the trays in the scene, (K, 2) [m]."""
        return centres_m(robot)[:1]

    def area_of(self, robot: Robot) -> str:
        """Check that the robot has enough trays."""
        self.tray_centres(robot)
        return self.area

    @classmethod
    def build_scene(
        cls, robot: Robot, targets: Sequence[Target], distractors: int
    ) -> LiftScene:
        """Build the scene of lifting with trays."""
        furnish = add_trays(robot, cls.tray_centres(robot))
        return build_lift_scene(robot, targets, distractors, furnish=furnish)

    def teacher(self, state: State) -> PlaceTeacher:
        """Make what takes the object to its tray."""
        return PlaceTeacher(state, self.tray_centres(state.scene.robot))

    def guide(self, straight: bool) -> type[PlaceGuide]:
        """Return what takes the object to the tray."""
        return PlaceGuide

    def is_over(self, offset: Floats) -> Mask:
        """Return which offsets from the destination (n, 2) [m] are above it, (n,)."""
        return is_over(offset)

    def memory(self, num_envs: int) -> NamedArrays:
        """Remember whether the object was taken, where it was, and for how long it has rested."""
        return {
            "taken": np.zeros(num_envs, bool),
            "rested": np.zeros(num_envs, np.int64),
            "centre": np.zeros((num_envs, 3)),
            DESTINATION: np.zeros((num_envs, 2)),
        }

    def begin(
        self, state: State, asked: Asking, ids: Indices, surroundings: Floats
    ) -> NamedArrays:
        """Let the object's destination be the tray."""
        tray = centres_m(state.scene.robot)[0]
        return {DESTINATION: np.tile(tray, (len(ids), 1))}

    def see(
        self,
        scene: Scene,
        sight: Sight,
        images: Images,
        facts: Mapping[str, Array],
        graph: KnowledgeGraph | None,
    ) -> Sight:
        """Know where the tray is."""
        tray = centres_m(scene.robot)[0]
        return sight._replace(destination=np.tile(tray, (len(images), 1)))

    def remember(self, state: State) -> NamedArrays:
        """Compare with the step before."""
        centre = state.simulator.centre(state.target)
        moved = norm(centre - state.memory["centre"], axis=1)
        is_there = self.is_over(_tray_offset(state))
        stands_there = stands(state.simulator, state.target) & is_there
        rests = state.memory["taken"] & stands_there & (moved < STILL_M)
        is_up = state.simulator.rise(state.target) >= self.height_m
        return state.memory | {
            "taken": state.memory["taken"] | is_up,
            "rested": np.where(rests, state.memory["rested"] + 1, 0),
            "centre": centre,
        }

    def success(self, state: State) -> Mask:
        """Return which objects have come to rest on the tray, with no other one disturbed, (n,)."""
        return (state.memory["rested"] >= self.hold_steps) & ~disturbed(state)

    def failure(self, state: State) -> Mask:
        """Return which episodes are lost, (n,) bool: the outcomes but the first and the last."""
        outcome = self._outcome(state)
        return (outcome != PLACED) & (outcome != UNFINISHED)

    def reward(self, state: State) -> Floats:
        """Compute the reward of a step, (n,).

        100 on success, and 5 for every step that is left, so that an arm that holds the object over
        the tray gains by letting go; otherwise, while both fingers touch the object, 5 - 10 d with
        d its distance from the tray [m]; otherwise the paper's -2 d^2 - a / 70 to the grasp frame.
        """
        held = HELD_REWARD - 10 * norm(_tray_offset(state), axis=1)
        to_grasp = paper_reward(state.distance, state.angle, state.success)
        value = np.where(state.simulator.touched(state.target), held, to_grasp)
        left = (self.max_steps - state.steps).clip(min=0)
        return np.where(state.success, SUCCESS_REWARD + HELD_REWARD * left, value)

    def infos(self, state: State) -> NamedArrays:
        """Add how far the object is from the tray [m], and how the episode ends."""
        return {
            "rise": state.simulator.rise(state.target),
            "gripped": state.simulator.touched(state.target),
            "disturbed": disturbed(state),
            "tray_distance": norm(_tray_offset(state), axis=1),
            "placing": np.array(self.outcomes)[self._outcome(state)],
        }

    def result(self, state: State, asked: Asking, env_id: int) -> str:
        """Say where it is."""
        return RESULTS[self._outcome(state)[env_id]]

    def columns(self, setting: Any, infos: NamedArrays) -> NamedArrays:
        """Store how each episode ended, and how far from the tray."""
        return {
            "placing": infos["placing"],
            "tray_distance_m": infos["tray_distance"],
        }

    def _outcome(self, state: State) -> Integers:
        """Return how episodes stand, numbers among ``OUTCOMES``, (n,)."""
        simulator = state.simulator
        target = state.target
        is_free = simulator.released(target)
        is_taken = state.memory["taken"]
        rise = simulator.rise(target)
        way = norm(simulator.place(target) - state.positions[:, 0], axis=1)
        has_fallen = rise < -FALLEN_M
        has_fallen |= is_free & (_tilt_deg(simulator, target) > TOPPLED_DEG)
        has_fallen |= ~is_taken & (way > LOST_M)
        is_down = is_taken & is_free & (rise < DOWN_M)
        is_beside = is_down & ~self.is_over(_tray_offset(state))
        outcome = np.full(len(way), UNFINISHED)
        outcome[is_beside] = BESIDE
        outcome[has_fallen] = FALLEN
        outcome[disturbed(state)] = DISTURBED
        outcome[simulator.unstable] = UNSTABLE
        outcome[self.success(state)] = PLACED
        return outcome


def _tray_offset(state: State) -> Floats:
    """Return x and y from the right tray's centre to the object's centre of mass, (n, 2) [m]."""
    centre = state.simulator.centre(state.target)[:, :2]
    return centre - state.memory[DESTINATION]


def _tilt_deg(simulator: LiftSimulator, objects: Integers) -> Floats:
    """Return the angle between the vertical of objects (n,) and the world's, (n,) [deg]."""
    _, turn = simulator.pose(objects)
    return np.degrees(np.arccos(turn[:, 2, 2].clip(-1.0, 1.0)))


def stands(simulator: LiftSimulator, objects: Integers) -> Mask:
    """Return whether objects (n,) stand upright, put down and without the gripper, (n,)."""
    is_down = np.abs(simulator.rise(objects)) < DOWN_M
    is_upright = _tilt_deg(simulator, objects) < UPRIGHT_DEG
    is_free = simulator.released(objects) & ~simulator.unstable
    return is_free & is_down & is_upright
