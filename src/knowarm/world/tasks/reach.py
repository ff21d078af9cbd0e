"""Reaching task: state and formulas of n episodes, on NumPy arrays or torch tensors.

One object is visible, or with ``EnvConfig.choice`` several, of which a query means one.

The order of a step is ``move`` -> ``outcome`` -> ``start_next`` for what has ended. Images are
drawn by the vector environments, from the simulator's poses and ``shown``.
"""

from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.appearance import AppearanceSource, Shown
from knowarm.world.arguments import check_state, masked_ids, spread_seeds
from knowarm.world.arrays import Array, Selection, array_namespace
from knowarm.world.backends import Simulator
from knowarm.world.choice_source import choice_table
from knowarm.world.config import EnvConfig
from knowarm.world.episodes import Episodes, EpisodeSource
from knowarm.world.robot import Robot
from knowarm.world.scene import Scene, list_facets, target_places
from knowarm.world.tasks import choose
from knowarm.world.tasks.reward import is_success, measure, reward_terms

ACTION_LEVELS = (0.0, 1.0, -1.0, 0.1, -0.1, 0.01, -0.01)
"""Joint increments of the seven actions, in units of MPI (paper, table 1)."""

_STATE = (
    "streams",
    "next_episode",
    "steps",
    "joint_targets",
    "target",
    "colour",
    "position",
    "look",
)
"""Arrays that, with the simulator's state, determine everything else."""

_SEVERAL = ("others", "other_colour", "other_position", "query")
"""Further such arrays where several objects are visible."""

VARYING = (
    *_STATE,
    *_SEVERAL,
    "grasp_position",
    "grasp_matrix",
    "distance",
    "angle",
    "success",
    "thresholds",
)
"""Attributes that a step replaces, besides ``shown``."""


def joint_increments(robot: Robot, config: EnvConfig) -> NDArray[np.float64]:
    """Return the joint increment of each action level [rad] (slides: [m]), (7,)."""
    mpi_rad = robot.mpi_rad if config.mpi_rad is None else config.mpi_rad
    return mpi_rad * np.array(ACTION_LEVELS)


class Outcome(NamedTuple):
    """How a step went, (n,) each."""

    reward: Array
    """Sum of the reward's terms, in the simulator's precision."""

    terminated: Array
    """Whether the target is reached, or with several objects another one, bool."""

    truncated: Array
    """Whether the time limit ends the episode, bool; never where ``terminated``."""

    @property
    def ended(self) -> Array:
        """Whether the episode has ended, (n,) bool."""
        return self.terminated | self.truncated


class ReachTask:
    """n environments in which an arm reaches for a target (paper, section 3).

    No array is written after it was assigned to an attribute: attributes may be handed out, and
    their owner must not write into them.

    Args:
        scene: robot and targets.
        config: the task.
        simulator: physics of n environments; it decides the array library and the precision.

    Attributes:
        facets: (target, colour) names; targets in config order, colours in theirs.
        queries: readable queries with several objects; empty in reaching.
        steps: steps played in the current episode, (n,) int64.
        joint_targets: joint angles that the servos track, (n, J) [rad]; actions add to them.
        target: index of the target, (n,) int64.
        colour: index among the target's colours, (n,) int64.
        position: x and y of the target, (n, 2) float64 [m].
        look: draws of the visual randomization, (n, L) float64.
        others: indices of the other visible targets, (n, M) int64; M = 0 in reaching.
        other_colour: indices among their colours, (n, M) int64.
        other_position: x and y of these, (n, M, 2) float64 [m].
        query: number of the query that means the target, (n,) int64; 0 in reaching.
        grasp_position: (n, 3) [m], world.
        grasp_matrix: rotation from grasp frame to world, row-major, (n, 9).
        shown: colours, cameras and lights for the renderer.
        distance: gripper to grasp point, (n,) [m].
        angle: between gripper and grasp frame, (n,) [deg].
        success: whether both are below their thresholds, (n,) bool.
        thresholds: of distance and angle, (2,) [m, deg].
        grasp_offset: grasp point of each target relative to its position, (K, 3) [m].
        grasp_rotation: rotation from each target's grasp frame to world, row-major, (K, 9).
    """

    distance: Array
    angle: Array
    success: Array

    def __init__(self, scene: Scene, config: EnvConfig, simulator: Simulator) -> None:
        self.scene = scene
        self.config = config
        self.simulator = simulator
        self.num_envs = n = simulator.num_envs
        self._arrays = arrays = simulator.arrays
        place, real = arrays.place, arrays.float_dtype
        self._source = EpisodeSource(scene, config, place)
        marked = config.choice is not None and config.choice.marked
        self._appearance = AppearanceSource(scene, config.randomization, place, marked)
        self.facets = list_facets(scene, config.colours)
        self.queries = choice_table(config).queries if config.choice else ()
        first = [[name for name, _ in self.facets].index(target.name) for target in scene.targets]
        self._first_facet = place(np.array(first, dtype=np.int64))
        self.target_numbers = place(np.arange(len(scene.targets)))
        self._state_names = _STATE if config.choice is None else (*_STATE, *_SEVERAL)
        self._increments = place(joint_increments(scene.robot, config).astype(real))
        self._home = place(scene.home)
        limits = scene.joint_lower, scene.joint_upper
        self._limits = tuple(place(limit) for limit in limits)
        self._rounded_limits = tuple(place(limit.astype(real)) for limit in limits)
        self.grasp_offset = place(scene.grasp_position)
        self.grasp_rotation = place(scene.grasp_matrix.reshape(-1, 9).astype(real))

        self.streams = place(np.random.SeedSequence().generate_state(n, np.uint64))
        self.next_episode = place(np.zeros(n, dtype=np.uint64))
        self.steps = place(np.zeros(n, dtype=np.int64))
        self.joint_targets = place(np.zeros((n, scene.num_joints), dtype=real))
        self.target = place(np.zeros(n, dtype=np.int64))
        self.colour = place(np.zeros(n, dtype=np.int64))
        self.position = place(np.zeros((n, 2)))
        self.look = place(np.zeros((n, config.randomization.draws)))
        others = config.choice.objects - 1 if config.choice else 0
        self.others = place(np.zeros((n, others), dtype=np.int64))
        self.other_colour = place(np.zeros((n, others), dtype=np.int64))
        self.other_position = place(np.zeros((n, others, 2)))
        self.query = place(np.zeros(n, dtype=np.int64))
        self.grasp_position = place(np.zeros((n, 3), dtype=real))
        self.grasp_matrix = place(np.zeros((n, 9), dtype=real))
        self.shown = Shown(None, None, None, None)
        self.threshold_factor = 1.0
        self._all = arrays.select(np.arange(n), n)
        self.start_next(self._all)

    @property
    def threshold_factor(self) -> float:
        """Factor of both thresholds, 1 unless training starts with larger ones.

        It can be set, for the following steps.
        """
        return self._threshold_factor

    @threshold_factor.setter
    def threshold_factor(self, factor: float) -> None:
        config, arrays = self.config, self._arrays
        self._threshold_factor = factor
        limits = np.array([config.success_distance_m * factor, config.success_angle_deg * factor])
        self.thresholds = arrays.place(limits.astype(arrays.float_dtype))

    @property
    def facet_ids(self) -> Array:
        """Row of the knowledge table for each current episode, (n,) int64: facet, or query."""
        return self.query if self.queries else self.facet

    @property
    def facet(self) -> Array:
        """Index of each episode's target and colour in ``facets``, (n,) int64."""
        return self._first_facet[self.target] + self.colour

    @property
    def objects(self) -> Array:
        """Indices of the visible targets, the wanted one first, (n, 1 + M) int64."""
        return array_namespace(self.target).concat([self.target[:, None], self.others], axis=1)

    def select_where(self, mask: Array) -> Selection:
        """Select environments by a mask, (n,) bool."""
        return self._arrays.select_where(mask)

    def reset(
        self, seed: int | list[int | None] | None, options: dict[str, Any] | None
    ) -> NDArray[np.intp]:
        """Start new episodes; see ``ReachVectorEnv.reset``.

        Returns:
            The environments that were reset, (k,).
        """
        options = options or {}
        n = self.num_envs
        ids = masked_ids(options.get("reset_mask"), n)
        given, seeds = spread_seeds(seed, n)
        seeded = ids[given[ids]]
        if len(seeded):
            self._seed(seeded, seeds[seeded])
        selection = self._arrays.select(ids, n)
        episodes = options.get("episodes")
        if episodes is None:
            self.start_next(selection)
        elif len(episodes) == len(ids):
            self._appearance.check(episodes)
            choose.check_objects(episodes, self.others.shape[1] + 1)
            rows = (getattr(episodes, field.name) for field in fields(episodes))
            self._start(selection, Episodes(*(self._arrays.spread(r, ids, n) for r in rows)))
        else:
            raise UserError(
                f"options['episodes'] holds {len(episodes)} episodes for {len(ids)} environments "
                "that are reset; pass one per environment."
            )
        return ids

    def start_next(self, selection: Selection) -> None:
        """Start the next episode of each selected environment's stream."""
        numbers = selection.take(self.next_episode)
        episodes = self._source(selection.take(self.streams), numbers)
        self.next_episode = selection.put(self.next_episode, numbers + 1)
        self._start(selection, episodes)

    def move(self, levels: Array) -> None:
        """Add the increments of actions (n, J) to the joint targets and simulate one step."""
        lower, upper = self._rounded_limits
        self.joint_targets = (self.joint_targets + self._increments[levels]).clip(lower, upper)
        self.simulator.step(self.joint_targets)
        self.steps = self.steps + 1
        self._measure()

    def outcome(self) -> Outcome:
        """Compute reward, success and time limit in the current state."""
        terms = reward_terms(self.distance, self.angle, self.success)
        reward = terms["success"] + terms["distance"] + terms["angle"]
        terminated = self.success | choose.is_mistaken(self) if self.queries else self.success
        truncated = (self.steps >= self.config.max_episode_steps) & ~terminated
        return Outcome(reward, terminated, truncated)

    def metrics(self) -> dict[str, Array]:
        """Return the infos of the current state, without masks, (n, ...) each."""
        infos = {
            "distance": self.distance,
            "angle": self.angle,
            "target": self.target,
            "colour": self.colour,
            "facet": self.facet,
            "is_success": self.success,
        }
        return infos if self.config.choice is None else infos | choose.choice_metrics(self)

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Copy all that determines the following steps to the host."""
        state = {name: self._arrays.to_host(getattr(self, name)) for name in self._state_names}
        return state | {"simulation": self.simulator.get_state()}

    def set_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore a state of ``get_state``, of a task with the same config and n.

        Raises:
            UserError: the state belongs to another kind of environment.
        """
        check_state(self.get_state(), state)
        for name in self._state_names:
            setattr(self, name, self._arrays.place(np.array(state[name])))
        self._refresh(self._all)
        self.simulator.set_state(
            state["simulation"],
            self.joint_targets,
            choose.target_positions(self, self._all),
            self.shown.distractor_position,
        )
        self._measure()

    def _seed(self, env_ids: NDArray[np.intp], values: NDArray[np.uint64]) -> None:
        """Give environments (k,) new streams, from their first episode."""
        streams, numbers = map(self._arrays.to_host, (self.streams, self.next_episode))
        streams[env_ids], numbers[env_ids] = values.view(streams.dtype), 0
        self.streams, self.next_episode = map(self._arrays.place, (streams, numbers))

    def _start(self, selection: Selection, episodes: Episodes) -> None:
        """Put selected environments at the start of episodes, whose arrays have m rows."""
        xp = array_namespace(self.position)
        joints = (self._home + episodes.joint_offsets).clip(*self._limits)
        joints = xp.astype(joints, self.joint_targets.dtype, copy=False)
        self.joint_targets = selection.put(self.joint_targets, joints)
        self.target = selection.put(self.target, episodes.target)
        self.colour = selection.put(self.colour, episodes.colour)
        self.position = selection.put(self.position, episodes.position)
        self.look = selection.put(self.look, episodes.look)
        for name in _SEVERAL:
            setattr(self, name, selection.put(getattr(self, name), getattr(episodes, name)))
        self.steps = selection.put(self.steps, xp.zeros_like(selection.take(self.steps)))
        distractors = self._refresh(selection)
        self.simulator.reset(
            selection,
            selection.take(self.joint_targets),
            choose.target_positions(self, selection),
            distractors,
        )
        self._measure()

    def _refresh(self, selection: Selection) -> Array | None:
        """Recompute grasp frames and appearance; return distractor positions, (m, D, 2) [m]."""
        xp = array_namespace(self.position)
        target, position = selection.take(self.target), selection.take(self.position)
        grasp = target_places(self.scene, position) + self.grasp_offset[target]
        grasp = xp.astype(grasp, self.grasp_position.dtype, copy=False)
        self.grasp_position = selection.update(self.grasp_position, grasp)
        self.grasp_matrix = selection.update(self.grasp_matrix, self.grasp_rotation[target])
        colours = xp.concat([self.colour[:, None], self.other_colour], axis=1)
        shown = self._appearance(
            selection.take(self.objects),
            selection.take(colours),
            position,
            selection.take(self.look),
        )
        self.shown = Shown(
            *(
                new if old is None else selection.update(old, new)
                for old, new in zip(self.shown, shown, strict=True)
            )
        )
        return shown.distractor_position

    def _measure(self) -> None:
        """Measure distance, angle and success in the current state."""
        config, simulator = self.config, self.simulator
        self.distance, self.angle = measure(
            simulator.tcp_position,
            simulator.tcp_matrix,
            self.grasp_position,
            self.grasp_matrix,
            config.ignore_roll,
        )
        self.success = is_success(self.distance, self.angle, self.thresholds[0], self.thresholds[1])
