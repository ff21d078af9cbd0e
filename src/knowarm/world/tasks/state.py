"""State of running episodes: the arrays from which tasks compute success, reward and infos."""

from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar

import numpy as np

from knowarm.arrays import Array, Floats, Indices, Integers, Mask, Names
from knowarm.errors import UserError
from knowarm.world.backend import MujocoSimulator
from knowarm.world.scene.scene import Scene, target_places
from knowarm.world.tasks.reward import measure

ACTION_LEVELS = (0.0, 1.0, -1.0, 0.1, -0.1, 0.01, -0.01)
"""Joint increments of the seven actions, in units of MPI (paper, table 1)."""


def nearest_levels(steps: Floats, count: int = len(ACTION_LEVELS)) -> Integers:
    """Return the first ``count`` levels' nearest one to joint steps (n, J) in units of MPI."""
    return np.abs(steps[..., None] - np.array(ACTION_LEVELS[:count])).argmin(axis=-1)


NamedArrays = dict[str, Array]
"""Arrays by name, with a first axis for environments or episodes."""

Frames = tuple[Floats, Floats]
"""Positions, (k, 3) [m], and rotations from frame to world, row-major, (k, 9)."""

Placed = tuple[Floats, Mask]
"""x and y of objects, (n, m, 2) [m], and a mask of them or of the n scenes."""

BOOL = "b"
"""Kind of the values of a mask, as NumPy calls it."""

NUMBERS = "iuf"
"""Kinds of the values of numbers."""


def returned(
    method: Callable[..., Any], values: Any, shape: tuple[int, ...], kinds: str
) -> Array:
    """Return what a method of a task's part returned, as an array.

    Raises:
        UserError: it is of another shape or kind.
    """
    array = np.asarray(values)
    if array.shape == shape and array.dtype.kind in kinds:
        return array
    owner = type(getattr(method, "__self__", None)).__name__
    what = "bool" if kinds == BOOL else "numbers"
    raise UserError(
        f"{owner}.{method.__name__} must return {what} of shape {shape}, got {array.dtype} of "
        f"shape {array.shape}: the first axis is for environments."
    )


def returned_rows(
    method: Callable[..., Any], arrays: Mapping[str, Any], count: int
) -> NamedArrays:
    """Return the named arrays of a method of a task's part, with ``count`` rows each.

    Raises:
        UserError: one has not.
    """
    rows = {}
    for name, values in arrays.items():
        shape = (count, *np.shape(values)[1:])
        rows[name] = returned(method, values, shape, np.asarray(values).dtype.kind)
    return rows


def places_of_all(objects: Integers, positions: Floats, count: int) -> Placed:
    """Return x and y of all K targets, (n, K, 2) [m], and which are visible, (n, K).

    Hidden ones are where the first visible one is.

    Args:
        objects: indices of the visible ones, (n, m).
        positions: their x and y, (n, m, 2) [m].
        count: K.
    """
    indices = objects[..., None]
    places = np.repeat(positions[:, :1], count, axis=1)
    np.put_along_axis(places, indices, positions, axis=1)
    return places, (indices == np.arange(count)).any(axis=1)


SimulatorT = TypeVar("SimulatorT", bound=MujocoSimulator)
"""Class of a task's simulator."""


class EpisodeState(Generic[SimulatorT]):
    """State of n running episodes with m visible objects each, of which the first is the goal.

    No array is written after it was assigned to an attribute: attributes may be handed out, and
    their owner must not write into them.
    """

    scene: Scene  #: Robot and objects
    simulator: SimulatorT  #: Physics of the n environments
    #: (object, colour) names; objects in config order, colours in theirs
    facets: tuple[tuple[str, str], ...]
    facet_names: Names  #: The same in words, as "mug/red", (F,)
    #: The queries of the task, (Q,); one empty name without questions
    query_names: Names
    ignore_roll: bool  #: Whether angles ignore the rotation about the approach axis
    limits: Floats  #: Thresholds of distance and angle in the config, (2,) [m, deg]
    #: Factor of both thresholds, 1 unless training starts with larger ones
    threshold_factor: float
    #: Joint increment of each action level [rad] (slides: [m]), (7,)
    increments: Floats
    steps: Integers  #: Steps played in the current episode, (n,)
    #: Joint angles that the servos track, (n, J) [rad]; actions add to them
    joint_targets: Floats
    #: Indices of the visible objects into the config's targets, (n, m)
    objects: Integers
    colours: Integers  #: Indices into the colours of these, (n, m)
    positions: Floats  #: Their x and y, (n, m, 2) [m]
    question: Integers  #: Number of each episode's query in ``query_names``, (n,)
    goal_position: Floats  #: Point that the gripper has to reach, world, (n, 3) [m]
    goal_matrix: Floats  #: Rotation from goal frame to world, row-major, (n, 9)
    distance: Floats  #: From gripper to goal, (n,) [m]
    angle: Floats  #: Between gripper and goal frame, (n,) [deg]
    success: Mask  #: Whether the task is solved, (n,)
    #: Further arrays of the task, (n, ...) each; see `Skill.memory`
    memory: NamedArrays
    #: Rotation from each target's grasp frame to world, row-major, (K, 9)
    grasp_rotation: Floats
    #: Number in ``facets`` of each target in its first colour, (K,)
    first_facet: Integers

    @property
    def thresholds(self) -> Floats:
        """The limits times the curriculum's factor, (2,) [m, deg]."""
        return self.limits * self.threshold_factor

    @property
    def target(self) -> Integers:
        """Index of the object to reach, (n,) int64."""
        return self.objects[:, 0]

    @property
    def facet(self) -> Integers:
        """Index of that object and its colour in ``facets``, (n,) int64."""
        return self.first_facet[self.target] + self.colours[:, 0]

    def goal_frames(self, objects: Integers, places: Floats) -> Frames:
        """Return the goal frames of objects (k,) at places (k, 2) [m]: (k, 3) [m] and (k, 9)."""
        raise NotImplementedError

    def measure_object(self, which: Integers) -> tuple[Floats, Floats]:
        """Measure distance (n,) [m] and angle (n,) [deg] to the goals of visible objects (n,)."""
        visible = (np.arange(len(which)), which)
        places = self.positions[visible]
        return self.measure_to(*self.goal_frames(self.objects[visible], places))

    def measure_to(self, position: Floats, matrix: Floats) -> tuple[Floats, Floats]:
        """Measure distance (n,) [m] and angle (n,) [deg] from the grippers to frames."""
        simulator = self.simulator
        return measure(
            simulator.tcp_position,
            simulator.tcp_matrix,
            position,
            matrix,
            self.ignore_roll,
        )

    def grasp_positions(self, ids: Indices | slice = slice(None)) -> Floats:
        """Compute the grasp points of the visible objects of k environments, (k, m, 3) [m]."""
        places = target_places(self.scene, self.positions[ids])
        return places + self.scene.grasp_position[self.objects[ids]]
