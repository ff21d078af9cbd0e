"""PickAndPlace of SO101-Nexus: put a cube on a disc that is drawn elsewhere, and let it go.

A re-implementation, in another simulation, of a task of SO101-Nexus (commit 3619f7d) from its
documentation. As there: the cube (25 mm, 10 g), the disc (10 cm wide, seen and not touched, at a
drawn place at least 55 mm from the cube), the start pose and its noise, 20.5 s at most, and when it
succeeds: the cube's centre within 2.5 cm of the disc's, on the support, slower than 1 cm/s and
released; for .2 s, as in its second version, which accepts all of the disc. It differs:

- The arm is of primitives; its jaw slides by 5 cm towards the fixed one, where the real one turns.
- Cube and disc are in a rectangle of 10 x 28 cm in which the gripper can point straight down. There
  they are in the half ring of 10 to 30 cm around (15, 0) cm, of which the arm does not reach all.
- The cube is not rotated. It has to be lifted by 3 cm and to end upright, and the episode ends
  where it is released elsewhere, toppled or pushed by 15 cm; there the arm may push or try again.
- Ten actions of at most .05 rad per second, there fifty; its training ends episodes after 10.2 s.
- Released means that no finger touches it; its second version measures what the support carries.
- A policy sees 64 x 64 pixels of a fixed camera; the published figures are of the exact state.

    knowarm evaluate oracle --env.task disc:OnDisc --env.robot so101.toml \\
        --env.targets cube.toml --episodes 300
    knowarm train bm-distil --env.task disc:OnDisc --config run.toml --seed 0 \\
        --total-steps 500000 --algorithm.processes 1
    knowarm evaluate runs/so101-on-disc-bm-distil/0 --tasks disc:OnDisc --episodes 1000
    knowarm view so101.toml --task disc:OnDisc --targets cube.toml
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, Literal

import numpy as np
from mujoco import MjSpec, mjtGeom
from numpy.typing import NDArray

from knowarm.world.objects.target import Target
from knowarm.world.robots.robot import Robot
from knowarm.world.tasks.asked.asked import Asking
from knowarm.world.tasks.skills.lift.model import LiftScene, build_lift_scene
from knowarm.world.tasks.skills.place.place import Place, PlaceSimulator
from knowarm.world.tasks.skills.place.teacher import PlaceTeacher
from knowarm.world.tasks.skills.teacher import GoalTable
from knowarm.world.tasks.state import EpisodeState

Floats = NDArray[np.float64]
State = EpisodeState[PlaceSimulator]

DISC = "disc"
RADIUS_M = 0.05
THICK_M = 0.001
RGBA = (0.0, 0.0, 1.0, 1.0)
APART_M = 0.0552
"""Least distance of the disc's centre from the cube's: 37.5 mm and half of the cube's diagonal."""
TRIES = 8
UP = np.array([0.0, 0.0, 1.0])


def add_disc(spec: MjSpec) -> None:
    """Add the disc, which is seen and not touched."""
    body = spec.worldbody.add_body(name=DISC, mocap=True)
    body.add_geom(
        type=mjtGeom.mjGEOM_CYLINDER,
        size=[RADIUS_M, THICK_M / 2, 0],
        pos=[0, 0, THICK_M / 2],
        rgba=RGBA,
        contype=0,
        conaffinity=0,
    )


class DiscTeacher(PlaceTeacher):
    """Carries the cube as low as the arm can point straight down, and lowers it on the disc."""

    approach_m = (0.02, 0.035)
    over_m = 0.01
    rise_m = (0.02, 0.045)
    close_m = 0.015
    heights_m = (0.045, 0.02, 0.002)
    leave_m = (0.0, 0.02, 0.045)

    def __init__(self, state: State) -> None:
        """Solve the poses over all places of the rectangle, in which the disc lies, too."""
        super().__init__(state, np.array([state.scene.robot.rectangle_centre_m]))
        self.state = state
        self.over = self.tables(self.heights_m[::-1])[::-1]
        self.away = self.tables(self.leave_m)

    def tables(self, heights_m: Sequence[float]) -> list[GoalTable]:
        """Return the tables of the grasp frame moved up, each solved from the last."""
        count = len(self.state.scene.targets)
        shifts = [np.tile(height * UP, (count, 1)) for height in heights_m]
        return list(accumulate(shifts, GoalTable.shifted, initial=self.goals))[1:]

    def at_disc(self, tables: Sequence[GoalTable]) -> Floats:
        """Return the joint angles over each episode's disc, (P, n, A) [rad]."""
        disc = self.state.memory["destination"]
        return np.stack([table(self.state.target, disc) for table in tables])

    def lowered(self) -> Floats:
        """Return joint angles with the cube over its disc, from above down, (H, n, A) [rad]."""
        return self.at_disc(self.over)

    def left(self) -> Floats:
        """Return joint angles on the way up from the cube, (B, n, A) [rad]."""
        return self.at_disc(self.away)


@dataclass(frozen=True, kw_only=True)
class OnDisc(Place):
    """Put the cube down within 2.5 cm of the centre of a disc, and let it go."""

    max_steps = 205  # 20.5 s, as 1024 steps there
    kind: Literal["on-disc"] = "on-disc"  # type: ignore[assignment]
    """Tag of this skill in JSON and in the names of experiments."""
    hold_steps: int = 2
    """Consecutive steps at rest, released, that count as success."""
    within_m: float = 0.025
    """Largest distance of the cube's centre from the disc's [m]."""

    @property
    def draws(self) -> int:
        """Number of draws per episode: places to try for the disc."""
        return 2 * TRIES

    @classmethod
    def build_scene(
        cls, robot: Robot, targets: Sequence[Target], distractors: int
    ) -> LiftScene:
        """Build the scene of lifting with a disc."""
        return build_lift_scene(robot, targets, distractors, furnish=add_disc)

    def area_of(self, robot: Robot) -> str:
        """Need no tray."""
        return self.area

    def begin(
        self,
        state: State,
        asked: Asking,
        ids: NDArray[np.intp],
        surroundings: Floats,
    ) -> dict[str, NDArray[Any]]:
        """Draw the place of the disc in the rectangle, apart from the cube, and put it there."""
        robot = state.scene.robot
        signed = 2 * surroundings.reshape(len(ids), TRIES, 2) - 1
        places = robot.rectangle_centre_m + signed * robot.rectangle_half_size_m
        way = np.linalg.norm(places - state.positions[ids, :1], axis=2)
        first_apart = np.argmax(
            way > APART_M, axis=1
        )  # none is in 1 of 27,000: the first
        disc = places[np.arange(len(ids)), first_apart]
        number = state.scene.model.body(DISC).mocapid[0]
        state.simulator.batch.bind("mocap_pos")[ids, number, :2] = disc
        return {"destination": disc}

    def is_over(self, offset: Floats) -> NDArray[np.bool_]:
        """Return which offsets from the disc's centre (n, 2) [m] are near enough, (n,)."""
        return np.asarray(np.linalg.norm(offset, axis=1) <= self.within_m)

    def teacher(self, state: State) -> DiscTeacher:
        """Make what takes the cube to the disc."""
        return DiscTeacher(state)
