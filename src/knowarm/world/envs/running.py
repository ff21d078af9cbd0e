"""Running episodes: state of n environments, and how a step changes it."""

from collections.abc import Callable
from operator import index
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from knowarm.arrays import Floats, Indices, Integers, Mask
from knowarm.errors import UserError
from knowarm.questions import find_rows, number_objects
from knowarm.world.backend import MujocoSimulator
from knowarm.world.config import EnvConfig, setting_of
from knowarm.world.envs.episodes import EpisodeSource
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.appearance import AppearanceSource, Shown
from knowarm.world.tasks.sampling import Episodes, Words
from knowarm.world.tasks.state import (
    ACTION_LEVELS,
    BOOL,
    NUMBERS,
    EpisodeState,
    Frames,
    NamedArrays,
    places_of_all,
    returned,
    returned_rows,
)

Seeds = int | list[int | None] | None
"""Seed of the first environment, one per environment, or none."""

Options = dict[str, Any]
"""Options of an environment or of its reset, by name."""

_STATE = (
    "streams",
    "next_episode",
    "steps",
    "joint_targets",
    "objects",
    "colours",
    "positions",
    "question",
    "look",
)
"""Arrays that, with the simulator's state and the task's memory, determine everything else."""


def joint_increments(robot: Robot, config: EnvConfig) -> Floats:
    """Return the joint increment of each action level [rad] (slides: [m]), (7,)."""
    mpi_rad = robot.mpi_rad if config.mpi_rad is None else config.mpi_rad
    return mpi_rad * np.array(ACTION_LEVELS)


class Outcome(NamedTuple):
    """How a step went, (n,) each."""

    reward: Floats
    """The task's reward."""
    terminated: Mask
    """Whether the task is solved or has failed."""
    truncated: Mask
    """Whether the time limit ends the episode; never where ``terminated``."""

    @property
    def ended(self) -> Mask:
        """Whether the episode has ended, (n,) bool."""
        return self.terminated | self.truncated


ChangeEpisodes = Callable[[Episodes, Words, Words], Episodes]
"""Changes episodes (k,), given their streams and numbers."""


class RunningEpisodes(EpisodeState[MujocoSimulator]):
    """n environments in which an arm plays the episodes of a task.

    The order of a step is ``move`` -> ``outcome`` -> ``start_next`` for what has ended. Images are
    drawn by the vector environments, from the simulator's poses and ``shown``.

    Attributes:
        task, setting: the task, and what its episodes are drawn from.
        streams, next_episode: seed of each environment's stream, and number in it, (n,) uint64.
        look: draws of the visual randomization, (n, L) float64.
        shown: colours, cameras and lights for the renderer.
        change_episodes: changes the start of new episodes of the streams in training; None leaves
            them as they are drawn.
    """

    def __init__(self, config: EnvConfig, simulator: MujocoSimulator) -> None:
        self.config = config
        self.task = task = config.task
        self.simulator = simulator
        self.setting = setting_of(config)
        self.scene = scene = self.setting.scene
        self.facets = self.setting.facets
        table = task.asked.questions(self.facets)
        queries = [""]
        if table is not None:
            queries = [query.name for query in table.queries]
        self._query_rows = {name: row for row, name in enumerate(queries)}
        self.query_names = np.array(queries)
        self.facet_names = np.array(["/".join(facet) for facet in self.facets])
        self.ignore_roll = config.ignore_roll
        self.limits = np.array([config.success_distance_m, config.success_angle_deg])
        self.num_envs = n = simulator.num_envs
        m = task.asked.visible
        self._source = EpisodeSource(config)
        self._appearance = AppearanceSource(
            scene, config.randomization, task.asked.paints_goal
        )
        numbers = number_objects(self.facets)
        _, self.first_facet = np.unique(numbers, return_index=True)
        self.increments = joint_increments(scene.robot, config)
        self.grasp_rotation = scene.grasp_matrix.reshape(-1, 9)
        self.streams = (
            np.random.SeedSequence().generate_state(n, np.uint64).astype(np.uint64)
        )
        self.next_episode = np.zeros(n, np.uint64)
        self.steps = np.zeros(n, np.int64)
        self.joint_targets = np.zeros((n, scene.num_joints))
        self.objects = np.zeros((n, m), np.int64)
        self.colours = np.zeros((n, m), np.int64)
        self.positions = np.zeros((n, m, 2))
        self.question = np.zeros(n, np.int64)
        self.look = np.zeros((n, config.randomization.draws))
        self.goal_position = np.zeros((n, 3))
        self.goal_matrix = np.zeros((n, 9))
        self._surroundings = np.zeros((n, task.skill.draws))
        self._fresh = returned_rows(task.skill.memory, task.skill.memory(n), n)
        self.memory = {name: array.copy() for name, array in self._fresh.items()}
        self.threshold_factor = 1.0
        self.change_episodes: ChangeEpisodes | None = None
        self._all = np.arange(n)
        self.start_next(self._all)

    @property
    def knowledge_input(self) -> Integers:
        """Row of the knowledge table for each current episode, (n,) int64: facet, or query."""
        rows = self.task.asked.knowledge_input
        return returned(rows, rows(self), (self.num_envs,), NUMBERS)

    def goal_frames(self, objects: Integers, places: Floats) -> Frames:
        """Return the goal frames of objects (k,) at places (k, 2) [m]: (k, 3) [m] and (k, 9)."""
        goal = self.task.skill.goal_frames
        position, matrix = goal(self.scene, objects, places)
        k = len(objects)
        return (
            returned(goal, position, (k, 3), NUMBERS),
            returned(goal, matrix, (k, 9), NUMBERS),
        )

    def instruct(self, env_id: int) -> str:
        """Return the goal of an environment's episode as a policy may know it; see `Task`."""
        return self.task.instruct(self, self.setting, env_id)

    def describe(self, env_id: int) -> str:
        """Describe the goal of an environment's episode, as "red mug"."""
        return self.task.describe(self, self.setting, env_id)

    def reset(self, seed: Seeds, options: Options | None) -> Indices:
        """Start new episodes; see ``ArmVectorEnv.reset``. Return the environments reset, (k,)."""
        options = options or {}
        ids = masked_ids(options.get("reset_mask"), self.num_envs)
        episodes = options.get("episodes")
        if episodes is not None:
            self._check(episodes, len(ids))
        is_seeded, seeds = spread_seeds(seed, self.num_envs)
        seeded = ids[is_seeded[ids]]
        self._write(seeded, streams=seeds[seeded], next_episode=0)
        if episodes is None:
            self.start_next(ids)
        else:
            self._start(ids, episodes)
        return ids

    def start_next(self, ids: Indices) -> None:
        """Start the next episode of the stream of each of some environments (k,)."""
        numbers = self.next_episode[ids]
        episodes = self._source(self.streams[ids], numbers)
        if self.change_episodes is not None:
            episodes = self.change_episodes(episodes, self.streams[ids], numbers)
        self._write(ids, next_episode=numbers + 1)
        self._start(ids, episodes)

    def move(self, steps: Floats, ids: Indices | None = None) -> None:
        """Add steps (n, J) [rad] to the joint targets and simulate one control period.

        Of environments (m,), by default of all.
        """
        scene = self.scene
        targets = self.joint_targets + steps
        self.joint_targets = targets.clip(scene.joint_lower, scene.joint_upper)
        self.simulator.step(self.joint_targets, ids)
        self.steps = self.steps + 1
        self._measure()
        if self.memory:
            remember = self.task.skill.remember
            self.memory = returned_rows(remember, remember(self), self.num_envs)
        self._judge()

    def outcome(self) -> Outcome:
        """Compute reward, end and time limit in the current state."""
        terminated = self.success
        failure = self.task.failure(self)
        if failure is not None:
            terminated = terminated | failure
        truncated = (self.steps >= self.config.max_episode_steps) & ~terminated
        rule = self.task.skill.reward
        reward = returned(rule, rule(self), (self.num_envs,), NUMBERS)
        return Outcome(reward, terminated, truncated)

    def infos(self) -> NamedArrays:
        """Return the infos of the current state, without masks, (n, ...) each."""
        return self.task.infos(self)

    def get_state(self) -> NamedArrays:
        """Copy all that determines the following steps."""
        state = {name: getattr(self, name).copy() for name in _STATE}
        state |= {f"memory.{name}": array.copy() for name, array in self.memory.items()}
        return state | {"simulation": self.simulator.get_state()}

    def set_state(self, state: NamedArrays) -> None:
        """Restore a state of ``get_state``, of an environment with the same config and n."""
        check_state(self.get_state(), state)
        for name in _STATE:
            setattr(self, name, np.array(state[name]))
        self.memory = {name: np.array(state[f"memory.{name}"]) for name in self.memory}
        self._refresh(self._all)
        self.simulator.set_state(state["simulation"])
        self._measure()
        self._judge()

    def _check(self, episodes: Episodes, count: int) -> None:
        """Check that episodes were drawn for this environment, of which ``count`` are reset."""
        if len(episodes) != count:
            raise UserError(
                f"options['episodes'] holds {len(episodes)} episodes for {count} environments "
                "that are reset; pass one per environment."
            )
        for what, theirs, ours in (
            ("joints", episodes.joint_offsets, self.joint_targets),
            ("objects", episodes.objects, self.objects),
            ("draws of visual randomization", episodes.look, self.look),
            ("draws of the skill", episodes.surroundings, self._surroundings),
        ):
            got = theirs.shape[1]
            expected = ours.shape[1]
            if got != expected:
                raise UserError(
                    f"The episodes hold {got} {what}, and this environment has {expected}; draw "
                    "them with its config."
                )
        numbers = episodes.objects
        names = np.array([target.name for target in self.scene.targets])
        is_known = (numbers >= 0) & (numbers < len(names))
        if not (is_known & (names[numbers * is_known] == episodes.names)).all():
            raise UserError(
                "The episodes show other objects than this environment has, or count them in "
                f"another order than {', '.join(names[:9])}; draw them with its config."
            )
        counts = np.diff(self.first_facet, append=len(self.facets))
        if ((episodes.colours < 0) | (episodes.colours >= counts[numbers])).any():
            raise UserError(
                "The episodes show colours that this environment does not have; draw them with its "
                "config."
            )

    def _start(self, ids: Indices, episodes: Episodes) -> None:
        """Put environments (k,) at the start of k episodes."""
        scene = self.scene
        joints = scene.home + episodes.joint_offsets
        joints = joints.clip(scene.joint_lower, scene.joint_upper)
        question = find_rows(
            "query of this environment", episodes.question, self._query_rows
        )
        self._write(
            ids,
            joint_targets=joints,
            objects=episodes.objects,
            colours=episodes.colours,
            positions=episodes.positions,
            question=question,
            look=episodes.look,
            steps=0,
        )
        self._begin(ids, episodes.surroundings)
        distractors = self._refresh(ids)
        places, visible = places_of_all(
            episodes.objects, episodes.positions, len(scene.targets)
        )
        self.simulator.reset(ids, joints, places, distractors, visible)
        self._measure()
        self._judge()

    def _begin(self, ids: Indices, surroundings: Floats) -> None:
        """Let the skill's memory of environments (k,) begin."""
        task = self.task
        begun = task.skill.begin(self, task.asked, ids, surroundings)
        memory = {}
        for name, array in self.memory.items():
            memory[name] = _put(array, ids, begun.get(name, self._fresh[name][ids]))
        self.memory = memory

    def _refresh(self, ids: Indices) -> Floats | None:
        """Recompute goals and appearance; return distractor positions, (k, D, 2) [m]."""
        objects = self.objects[ids]
        places = self.positions[ids, 0]
        position, matrix = self.goal_frames(objects[:, 0], places)
        self._write(ids, goal_position=position, goal_matrix=matrix)
        appearance = self._appearance(
            objects, self.colours[ids], places, self.look[ids]
        )
        self.task.skill.paint(self, ids, appearance.rgba)
        if len(ids) == self.num_envs:
            self.shown = appearance
        else:
            pairs = zip(self.shown, appearance, strict=True)
            merged = [_put(old, ids, new) for old, new in pairs]
            self.shown = Shown(*merged)
        return appearance.distractor_position

    def _write(self, ids: Indices, **rows: Any) -> None:
        """Replace arrays by copies with new values (k, ...) in the rows of environments (k,)."""
        for name, values in rows.items():
            setattr(self, name, _put(getattr(self, name), ids, values))

    def _judge(self) -> None:
        """Find which episodes are solved in the current state."""
        rule = self.task.skill.success
        self.success = returned(rule, rule(self), (self.num_envs,), BOOL)

    def _measure(self) -> None:
        """Measure distance and angle in the current state."""
        self.distance, self.angle = self.measure_to(
            self.goal_position, self.goal_matrix
        )


def _put(array: Any, ids: Indices, values: Any) -> Any:
    """Return a copy of ``array`` (n, ...) with ``values`` (k, ...) in the rows ``ids``.

    Where there are no values it is None, and so is the result.
    """
    if values is None:
        return None
    result = array.copy()
    result[ids] = values
    return result


def check_state(mine: NamedArrays, state: NamedArrays) -> None:
    """Check that a state has arrays of the same names and shapes as the environment's own."""
    expected = {name: array.shape for name, array in sorted(mine.items())}
    got = {name: array.shape for name, array in sorted(state.items())}
    if got != expected:
        raise UserError(
            f"The state belongs to another environment: its arrays are {got}, those of "
            f"this environment are {expected}. Use the same robot, targets and number of "
            "environments."
        )


def masked_ids(mask: ArrayLike | None, num_envs: int) -> Indices:
    """Return the indices of a reset mask, an array or a tensor; all of them for None."""
    if mask is None:
        return np.arange(num_envs)
    if hasattr(mask, "cpu"):
        mask = mask.cpu()
    array = np.asarray(mask)
    if array.shape != (num_envs,) or array.dtype != np.bool_ or not array.any():
        raise UserError(
            f"options['reset_mask'] must be a bool array of shape ({num_envs},) with at "
            f"least one True, got {array.dtype} of shape {array.shape}."
        )
    return np.flatnonzero(array)


def spread_seeds(seed: Seeds, num_envs: int) -> tuple[Mask, Words]:
    """Expand Gymnasium's seed argument to one seed per environment: seed, seed + 1, ...

    Return which environments get a seed, (n,), and the seeds, 0 for the others, (n,).
    """
    seeds: Any = seed
    if seed is None:
        seeds = np.full(num_envs, None)
    elif isinstance(seed, int | np.integer):
        seeds = range(int(seed), int(seed) + num_envs)
    values = np.atleast_1d(np.array(seeds, object))
    is_seeded = np.not_equal(values, np.array(None))
    values[~is_seeded] = 0
    allowed = f"an integer or a list of {num_envs} (one per environment)"
    try:
        integers = np.array([*map(index, values)], object)
    except TypeError:
        raise UserError(f"seed must be {allowed}, got {seed!r}.") from None
    if len(integers) != num_envs:
        raise UserError(f"seed must be {allowed}, got {len(integers)}.")
    if (integers < 0).any():
        raise UserError(f"seed must not be negative, got {seed}.")
    return is_seeded, (integers % 2**64).astype(np.uint64)
