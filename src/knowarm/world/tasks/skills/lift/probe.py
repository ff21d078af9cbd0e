"""Lift test: replay joint paths among solid objects, close the fingers, lift 10 cm and hold."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.linalg import norm

from knowarm.arrays import Floats, Integers, Mask, Names
from knowarm.cores import available_cores
from knowarm.errors import UserError
from knowarm.measures import Columns, Measure
from knowarm.questions import object_of
from knowarm.world.objects.target import Target
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.compose import CONTROL_PERIOD_S
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.probe import BaseProbe, Findings, PlayedEpisodes, ReportTable
from knowarm.world.tasks.skills.ik import InverseKinematics
from knowarm.world.tasks.skills.lift.model import LiftScene, build_lift_scene
from knowarm.world.tasks.skills.lift.simulator import LiftSimulator

TIMESTEP_S = 0.002
CLOSE_STEPS = 10  # Control periods of .1 s
LIFT_STEPS = 20
HOLD_STEPS = 20
LIFT_M = 0.10  # Way of the gripper upwards
LIFTED_M = 0.08  # Rise of the object's centre of mass from which it is lifted
# Way of the object before the fingers close from which it counts as pushed
MOVED_M = 0.02
WAYPOINTS = 5  # Poses of the path upwards

OUTCOMES = {
    "lifted": "it rose by 8 cm and was between the pads to the end",
    "pushed": "the arm had moved it by more than 2 cm before the fingers closed",
    "missed": "closed fingers did not both touch it",
    "arm": "the gripper rose by less than 8 cm",
    "slipped": "it was touched by both fingers, and lost or left low",
}
"""How a lift can end, in the order in which causes are looked for."""

NOT_REACHED = "not reached"
"""Lifts of episodes without success."""
EXCLUDED = "excluded"
"""Lifts of objects that the robot's ``cannot_hold`` names."""


@dataclass(frozen=True, kw_only=True)
class Lifts:
    """Results of n lifts."""

    outcome: Names  # Name in ``OUTCOMES``, (n,)
    rise: Floats  # Rise of the object's centre of mass at the end [m], (n,)
    moved: Floats  # Way of the centre of mass before the fingers close [m], (n,)


def lift(
    scene: Scene, paths: Sequence[Floats], objects: Integers, positions: Floats
) -> Lifts:
    """Replay n joint paths among solid objects, and lift the first object where each ends.

    Episodes with the same objects are simulated as one batch; the result of one depends on itself
    only.

    Args:
        scene: robot and objects; its own model is not changed.
        paths: joint angles per control period from the start to the grasp, (T, J) [rad] each.
        objects: indices of the visible objects into the scene's targets, (n, m); of several parts
            of one object the first counts.
        positions: their x and y, (n, m, 2) [m].
    """
    upward = plan_lifts(scene, np.stack([path[-1] for path in paths]))
    outcome = np.full(len(paths), "", dtype=f"U{max(map(len, OUTCOMES))}")
    rise = np.zeros(len(paths))
    moved = np.zeros(len(paths))
    for visible in np.unique(objects, axis=0):
        rows = np.flatnonzero((objects == visible).all(axis=1))
        names = [object_of(scene.targets[k].name) for k in visible]
        _, columns = np.unique(names, return_index=True)
        columns.sort()  # of several parts of an object the first
        targets = [scene.targets[k] for k in visible[columns]]
        trial = LiftTrial(build_trial_scene(scene.robot, targets), len(rows))
        places = positions[rows][:, columns]
        for _ in trial.play(
            [paths[row] for row in rows.tolist()], upward[rows], places
        ):
            pass
        outcome[rows] = trial.outcome()
        rise[rows] = trial.rise
        moved[rows] = trial.moved
    return Lifts(outcome=outcome, rise=rise, moved=moved)


def plan_lifts(scene: Scene, joints: Floats) -> Floats:
    """Solve for joint angles that move the gripper 10 cm upwards without turning it.

    Args:
        scene: the robot.
        joints: angles at which each lift starts, (n, J) [rad].

    Returns:
        Angles at ``WAYPOINTS`` equal distances, without the start, (n, WAYPOINTS, J) [rad].
    """
    solver = InverseKinematics(scene, starts=1)
    position, matrix = solver.pose(joints)
    heights = np.linspace(0.0, LIFT_M, WAYPOINTS + 1)[1:]
    shifts = np.outer(heights, [0.0, 0.0, 1.0])
    return solver.solve_path(position, matrix, joints, shifts)


def build_trial_scene(robot: Robot, targets: Sequence[Target]) -> LiftScene:
    """Build the scene of lifts of the first of m objects.

    Raises:
        UserError: the robot has no fingers.
    """
    return build_lift_scene(robot, targets, timestep_s=TIMESTEP_S)


class LiftTrial:
    """n simulations of the lifting of the first of m objects, and what was measured in them.

    Attributes:
        simulator: the simulations.
        rise, moved: as in `Lifts`; complete once `play` has ended.
    """

    def __init__(self, scene: LiftScene, num_trials: int) -> None:
        threads = min(num_trials, available_cores())
        substeps = round(CONTROL_PERIOD_S / TIMESTEP_S)
        self.simulator = LiftSimulator(
            scene, num_trials, threads, free_substeps=substeps
        )
        self._first = np.zeros(num_trials, np.int64)
        self.rise = np.zeros(num_trials)
        self.moved = np.zeros(num_trials)

    def play(
        self, paths: Sequence[Floats], upward: Floats, positions: Floats
    ) -> Iterator[str]:
        """Simulate n lifts; yield the phase after each control period.

        Shorter paths wait at their end for the longest.

        Args:
            paths: see `lift`.
            upward: of `plan_lifts`, (n, WAYPOINTS, J).
            positions: see `lift`.
        """
        simulator = self.simulator
        first = self._first
        fingers = 0.0
        steps = max(map(len, paths))
        whole = [
            np.pad(path, ((0, steps - len(path)), (0, 0)), mode="edge")
            for path in paths
        ]
        poses = np.stack(whole, axis=1)
        simulator.reset(np.arange(len(paths)), _beside(poses[0], fingers), positions)
        placed = simulator.centre(first)
        for arm in poses:
            simulator.step(_beside(arm, fingers))
            yield "approach"
        before = simulator.centre(first)
        self.moved[:] = norm(before - placed, axis=1)
        for step in range(CLOSE_STEPS):
            fingers = simulator.scene.joint_upper[-1] * (step + 1) / (CLOSE_STEPS - 2)
            simulator.step(_beside(arm, fingers))
            yield "close"
        self._touched = simulator.touched(first)
        gripper = simulator.tcp_position[:, 2].copy()
        rise = np.concatenate([arm[:, None], upward], axis=1)
        for step in range(LIFT_STEPS):
            at = (step + 1) * WAYPOINTS / LIFT_STEPS
            low = min(int(at), WAYPOINTS - 1)
            share = at - low
            arm = (1 - share) * rise[:, low] + share * rise[:, low + 1]
            simulator.step(_beside(arm, fingers))
            yield "lift"
        self._held = simulator.touched(first)
        for _ in range(HOLD_STEPS):
            simulator.step(_beside(arm, fingers))
            yield "hold"
            self._held &= simulator.touched(first)
        self.rise[:] = simulator.centre(first)[:, 2] - before[:, 2]
        self._gripper_rise = simulator.tcp_position[:, 2] - gripper

    def outcome(self) -> Names:
        """Name how each lift ended, (n,); see ``OUTCOMES``."""
        held = self._held & (self.rise >= LIFTED_M)
        causes = [
            held,
            self.moved > MOVED_M,
            ~self._touched,
            self._gripper_rise < LIFTED_M,
        ]
        return np.select(causes, list(OUTCOMES)[:4], "slipped")


def _beside(arm: Floats, fingers: float) -> Floats:
    """Return joint targets of arm (n, J) and fingers, (n, J + 1)."""
    return np.column_stack([arm, np.full(len(arm), fingers)])


def _of_all(episodes: Columns) -> Mask:
    """Select the episodes whose object the gripper can lift."""
    return np.isin(episodes["lift"], [*OUTCOMES, NOT_REACHED])


def _of_successes(episodes: Columns) -> Mask:
    """Select the episodes in which a lift was tried."""
    return np.isin(episodes["lift"], list(OUTCOMES))


_MEASURES = (
    Measure("lifted", "lifted of all", "lift", equals="lifted", among=_of_all),
    Measure(
        "grasps",
        "lifted of the successes",
        "lift",
        equals="lifted",
        among=_of_successes,
    ),
    *[
        Measure(f"lift_{name}", name, "lift", equals=name, among=_of_all, about=about)
        for name, about in OUTCOMES.items()
        if name != "lifted"
    ],
)


@dataclass(frozen=True, kw_only=True)
class LiftProbe(BaseProbe):
    """Lift the object where an episode succeeds.

    Its joint path is replayed among solid objects, the fingers close, the arm lifts 10 cm and holds
    2 s.
    """

    label = "lift"
    about = (
        "Lift the object where an episode succeeds, in a simulation with solid objects."
    )
    measures = _MEASURES
    column_meanings: ClassVar[dict[str, str]] = {
        "lift": "how the lift of the object ended: see OUTCOMES of the lift test",
        "lift_rise_m": "rise of the object's centre of mass in the lift [m]",
    }
    table = ReportTable(
        name="lifts",
        title="How many successes are grasps",
        measures=tuple(measure.name for measure in _MEASURES),
        note="The joint path of every successful episode is replayed among solid objects, the "
        "fingers close, the arm lifts 10 cm and holds 2 s. Pushed, missed, arm, slipped: how the "
        "others ended, of all. Objects that the gripper cannot lift are left out of these columns.",
    )
    kind: Literal["lift"] = "lift"

    def check(self, scene: Scene, task: str) -> None:
        """Refuse tasks whose actions move fingers, and robots without fingers."""
        if scene.joint_names != scene.robot.joints:
            raise UserError(
                "A lift test lifts where episodes of a task end that moves the arm only; the task "
                f"{task!r} moves the fingers. Leave out the lift test."
            )
        build_trial_scene(scene.robot, scene.targets[:1])

    def measure(self, played: PlayedEpisodes, findings: Findings) -> None:
        """Lift the object of every successful episode; add ``lift`` and ``lift_rise_m``, (n,).

        Every episode ends at its first state within the thresholds, so each is lifted at most once.
        """
        scene = played.scene
        episodes = played.episodes
        names = np.array([target.name for target in scene.targets])
        is_excluded = np.isin(names[episodes.target], list(scene.robot.cannot_hold))
        chosen = np.flatnonzero(played.success & ~is_excluded)
        outcome = np.where(is_excluded, EXCLUDED, NOT_REACHED).astype("U16")
        rise = np.zeros(len(episodes))
        if len(chosen):
            paths = played.paths(chosen)
            lifts = lift(
                scene, paths, episodes.objects[chosen], episodes.positions[chosen]
            )
            outcome[chosen] = lifts.outcome
            rise[chosen] = lifts.rise
        findings.columns |= {"lift": outcome, "lift_rise_m": rise}
