"""Base of the vector environments: what they hold, observe and return, and what actions mean."""

from typing import Any, Generic, Literal, TypeVar, get_args

import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.linalg import norm
from numpy.typing import ArrayLike

from knowarm.arrays import (
    Array,
    Floats,
    Floats32,
    Images,
    Indices,
    Integers,
    Mask,
)
from knowarm.errors import UserError, unknown_name, warn
from knowarm.world.config import EnvConfig, row_names, scene_of
from knowarm.world.envs.running import Options, RunningEpisodes, Seeds
from knowarm.world.render.renderer import Renderer, make_renderer
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.state import ACTION_LEVELS, NamedArrays

Action = Literal["levels", "continuous"]
"""Integers that index ``ACTION_LEVELS``; or joint steps in units of the MPI, -1 to 1."""

Observed = Literal["image", "joints", "knowledge"]
"""Image of the camera; angles of the joints [rad]; the knowledge vector of the episode."""

Observe = Literal["image"] | tuple[Observed, ...]
"""The image itself, or the parts of a ``Dict``."""


Infos = dict[str, Any]
"""Infos of Gymnasium by name."""

ArrayT = TypeVar("ArrayT")
"""What an environment returns: NumPy arrays or tensors."""


class BaseVectorEnv(VectorEnv[Any, ArrayT, ArrayT], Generic[ArrayT]):
    """n environments in which an arm plays the episodes of a task; see ``ArmVectorEnv``."""

    def __init__(
        self, config: EnvConfig, num_envs: int, num_threads: int, **interface: Any
    ) -> None:
        if not isinstance(num_envs, int | np.integer) or num_envs < 1:
            raise UserError(
                f"num_envs must be a whole number of at least 1, got {num_envs!r}."
            )
        self.config = config
        self.num_envs = num_envs
        scene = scene_of(config)
        self.scene = scene
        _question_distance(config, scene)
        self._interface = Interface(config, scene, **interface)
        self.single_observation_space = self._interface.observation_space
        self.single_action_space = self._interface.action_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.renderer: Renderer = make_renderer(
            scene, config, config.image_size, num_threads
        )
        self.simulation = config.task.skill.simulator(
            scene, num_envs, num_threads, config.dynamics
        )
        self.running = RunningEpisodes(config, self.simulation)
        self.facets = self.running.facets
        # Which episodes have ended and wait for a reset; all before the first reset
        self._ended = np.ones(num_envs, bool)

    @property
    def joint_positions(self) -> ArrayT:
        """Current joint angles, (n, J) float64 [rad]."""
        return self._out(self.simulation.joint_positions)

    @property
    def joint_targets(self) -> ArrayT:
        """Joint angles that the servos track, (n, J) float64 [rad]; actions add to them."""
        return self._out(self.running.joint_targets)

    @property
    def knowledge_input(self) -> ArrayT:
        """Row of the knowledge table for each current episode, (n,) int64: facet, or query."""
        return self._out(self.running.knowledge_input)

    def reset(
        self,
        *,
        seed: Seeds = None,
        options: Options | None = None,
    ) -> tuple[Any, Infos]:
        """Start a new episode in every environment, or in those of a mask.

        Args:
            seed: stream of the first environment (the others follow), or one per environment;
                None continues the current streams.
            options: "episodes", the ``Episodes`` to play instead of drawn ones, one for each
                environment that is reset; "reset_mask", (n,) bool, the environments to reset, an
                array or a tensor.

        Raises:
            UserError: a seed, mask or list of episodes of the wrong length.
        """
        self._ended[self.running.reset(seed, options)] = False
        return self._observe(), self._infos()

    def get_state(self) -> NamedArrays:
        """Copy all that determines the following steps, to the byte."""
        return self.running.get_state()

    def set_state(self, state: NamedArrays) -> None:
        """Restore a state of ``get_state``, of an environment with the same config and n.

        Raises:
            UserError: the state belongs to another kind of environment.
        """
        self.running.set_state(state)

    def _out(self, array: Array) -> Any:
        """Return an array as the environment returns it."""
        raise NotImplementedError

    def _observe(self) -> Any:
        """Return the observations of all environments, new."""
        raise NotImplementedError

    def _infos(self, where: Mask | None = None) -> Infos:
        """Return the infos of the current state, each with its mask: ``where``, or everywhere."""
        if where is None:
            where = np.ones(self.num_envs, bool)
        infos: Infos = {}
        for name, values in self.running.infos().items():
            infos[name] = self._out(values)
        masks = [f"_{name}" for name in infos]
        return infos | dict.fromkeys(masks, self._out(where))

    def _move(self, actions: Any) -> None:
        """Simulate one step of actions (n, J)."""
        steps = self._interface.steps(actions, self.num_envs, self.running.increments)
        self.running.move(steps)


def _question_distance(config: EnvConfig, scene: Scene) -> None:
    """Warn of a success distance that is longer than the diagonal of the rectangle."""
    sides = 2 * np.array(scene.robot.rectangle_half_size_m)
    if config.success_distance_m > norm(sides):
        width, depth = sides
        warn(
            f"Objects stand in a rectangle of {width:g} x {depth:g} m, and the success distance of "
            f"{config.success_distance_m:g} m is longer: every place in it counts as near enough."
        )


def draw_images(
    renderer: Renderer, running: RunningEpisodes, ids: Indices | slice = slice(None)
) -> Images:
    """Draw k environments, (k, H, W, 3) uint8, a new array."""
    simulator = running.simulator
    shown = running.shown
    views = None if shown.views is None else shown.views[ids]
    lamps = None if shown.lamps is None else shown.lamps[ids]
    return renderer.draw(
        simulator.geom_position[ids],
        simulator.geom_matrix[ids],
        shown.rgba[ids],
        views,
        lamps,
    )


class Interface:
    """Spaces of one environment, and the conversion of observations and actions of n.

    Args:
        config: robot and task.
        scene: its J joints are those that the actions move.
        action: what an action is.
        observe: "image" for the image itself, or the names of the parts of a ``Dict``.
        knowledge: (R, K), one row per `Task.knowledge_rows`, where ``observe`` names "knowledge".

    Raises:
        UserError: an unknown name, or a table that is missing, of another shape, or not observed.
    """

    def __init__(
        self,
        config: EnvConfig,
        scene: Scene,
        action: Action = "levels",
        observe: Observe = "image",
        knowledge: ArrayLike | None = None,
    ) -> None:
        names: tuple[str, ...] = (
            (observe,) if isinstance(observe, str) else tuple(observe)
        )
        for name in names:
            _check_name("part of an observation", name, get_args(Observed))
        _check_name("kind of action", action, get_args(Action))
        self._names = names
        self._is_continuous = action == "continuous"
        self._table = _checked_table(config, names, knowledge)
        shape = (config.image_size, config.image_size, 3)
        joints = scene.num_joints
        # Contacts push joints beyond their limits.
        reach = scene.joint_upper - scene.joint_lower
        self._lower = (scene.joint_lower - reach).astype(np.float32)
        self._upper = (scene.joint_upper + reach).astype(np.float32)
        parts: dict[str, spaces.Space[Any]] = {
            "image": spaces.Box(0, 255, shape, np.uint8),
            "joints": spaces.Box(self._lower, self._upper, dtype=np.float32),
            "knowledge": spaces.Box(-np.inf, np.inf, self._table.shape[1:], np.float32),
        }
        self.observation_space: spaces.Space[Any] = parts["image"]
        if observe != "image":
            self.observation_space = spaces.Dict({name: parts[name] for name in names})
        levels = np.full(joints, len(ACTION_LEVELS))
        self.action_space: spaces.Space[Any] = spaces.MultiDiscrete(levels)
        if self._is_continuous:
            self.action_space = spaces.Box(-1.0, 1.0, (joints,), np.float32)

    def observe(self, images: Images, joints: Floats, rows: Integers) -> NamedArrays:
        """Return the named parts of n observations, (n, ...) each; ``rows`` of the table, (n,).

        Joints that are further beyond a limit than their range is wide are clipped to that.
        """
        angles = joints.astype(np.float32).clip(self._lower, self._upper)
        parts: NamedArrays = {"image": images, "joints": angles}
        if "knowledge" in self._names:
            parts["knowledge"] = self._table[rows]
        return {name: parts[name] for name in self._names}

    def steps(self, actions: ArrayLike, num_envs: int, increments: Floats) -> Floats:
        """Return the joint steps of actions (n, J) [rad], from the increments of the levels (7,).

        Raises:
            UserError: actions of the wrong shape or type, or out of range.
        """
        shape = (num_envs, *self.action_space.shape)  # type: ignore[misc]
        checked = _checked_actions(actions, shape, self._is_continuous)
        if self._is_continuous:
            return checked.astype(np.float64) * increments[1]
        return increments[checked]


def _check_name(what: str, name: str, allowed: tuple[str, ...]) -> None:
    """Check that a name is an allowed one."""
    if name not in allowed:
        raise unknown_name(what, name, allowed)


def _checked_table(
    config: EnvConfig, names: tuple[str, ...], knowledge: ArrayLike | None
) -> Floats32:
    """Return the knowledge table, (R, K); without rows where it is not observed."""
    if "knowledge" not in names:
        if knowledge is not None:
            raise UserError(
                "knowledge is a table that observations do not show; name it in observe, such as "
                "observe=('image', 'knowledge')."
            )
        return np.zeros((0, 0), np.float32)
    rows = row_names(config)
    if knowledge is None:
        knowledge = []
    table = np.asarray(knowledge, np.float32)
    if table.ndim != 2 or table.shape[0] != len(rows) or table.shape[1] == 0:
        raise UserError(
            f"knowledge must be a table with one row for each of the {len(rows)} values of the "
            f"info {config.task.asked.knowledge_info!r}, which begin with {rows[0]!r}; got shape "
            f"{table.shape}. Leave 'knowledge' out of observe to do without."
        )
    return table


def _checked_actions(
    actions: ArrayLike, shape: tuple[int, int], is_continuous: bool
) -> Array:
    """Return actions of a shape (n, J): numbers of levels, or continuous ones."""
    kinds = "iu"
    lowest = 0
    highest = len(ACTION_LEVELS) - 1
    allowed = f"integers from 0 to {highest}"
    if is_continuous:
        kinds = "f"
        lowest = -1
        highest = 1
        allowed = "floats from -1 to 1 (in units of the maximum position increment)"
    array = np.asarray(actions)
    if array.shape != shape or array.dtype.kind not in kinds:
        got = f"{array.dtype} of shape {array.shape}"
    elif not ((lowest <= array) & (array <= highest)).all():
        got = f"{array.min()} to {array.max()}"
    else:
        return array
    raise UserError(
        f"actions must be {allowed} of shape {shape} (environments, joints), got {got}."
    )
