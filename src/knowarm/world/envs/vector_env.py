"""Vector environments: their base, and the NumPy one, Gymnasium's ``VectorEnv`` on MuJoCo."""

from typing import Any, Generic, Literal, TypeVar, get_args

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, iterate
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

RENDER_SIZE = 480  # Width and height of the images that ``render`` returns [px]

Action = Literal["levels", "continuous"]
"""Integers that index ``ACTION_LEVELS``; or joint steps in units of the MPI, -1 to 1."""

Observed = Literal["image", "joints", "knowledge"]
"""Image of the camera; angles of the joints [rad]; the knowledge vector of the episode."""

Observe = Literal["image"] | tuple[Observed, ...]
"""The image itself, or the parts of a ``Dict``."""

Infos = dict[str, Any]
"""Infos of Gymnasium by name."""

Step = tuple[Any, Floats, Mask, Mask, Infos]
"""Observations (n, ...), reward (n,), terminated (n,), truncated (n,) and infos."""

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

    def _move(self, actions: Any, ids: Indices | None = None) -> None:
        """Simulate one step of actions (n, J), in all environments or in some, (m,)."""
        steps = self._interface.steps(actions, self.num_envs, self.running.increments)
        self.running.move(steps, ids)


class ArmVectorEnv(BaseVectorEnv[Array]):
    """n environments in which an arm plays the episodes of a task (paper, section 3).

    Observations are uint8 images (n, H, W, 3), actions int64 (n, J) that index
    ``ACTION_LEVELS``, unless ``observe`` and ``action`` say otherwise. With seed s, environment i
    plays the episodes of stream s + i, so an episode does not depend on n. Every returned array is
    new and belongs to the caller.

    Infos are those of the task, `Task.infos`: arrays (n,) such as distance [m], angle [deg], target
    and colour (indices), facet (its name, as "mug/red") and is_success, each with Gymnasium's mask
    ``_name``.

    Args:
        config: robot, task and objects.
        num_envs: n.
        num_threads: threads of physics and rendering; 0 for one per core.
        autoreset_mode: Gymnasium's; SAME_STEP adds ``final_obs`` and ``final_info``.
        render_mode: "rgb_array", or None.
        action: "levels"; or "continuous" for joint steps in units of the MPI, (n, J) in -1 to 1.
        observe: "image"; or a tuple of "image", "joints" (their angles, (n, J) [rad]) and
            "knowledge" for a ``Dict``.
        knowledge: the table of "knowledge", (R, K), with a row per `Task.knowledge_rows`.

    Attributes:
        running: the state of the episodes.
        simulation: the physics.
        renderer: draws the observations; any ``Renderer`` may be assigned.
        facets: (target, colour) names; targets in config order, colours in theirs.
    """

    def __init__(
        self,
        config: EnvConfig,
        num_envs: int,
        num_threads: int = 0,
        autoreset_mode: AutoresetMode = AutoresetMode.SAME_STEP,
        render_mode: str | None = None,
        *,
        action: Action = "levels",
        observe: Observe = "image",
        knowledge: ArrayLike | None = None,
    ) -> None:
        super().__init__(
            config,
            num_envs,
            num_threads,
            action=action,
            observe=observe,
            knowledge=knowledge,
        )
        self.render_mode = render_mode
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": 10,
            "autoreset_mode": AutoresetMode(autoreset_mode),  # or its value
        }
        self._large_renderer: Renderer | None = None
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def step(self, actions: ArrayLike) -> Step:
        """Play one step in every environment; see Gymnasium's ``VectorEnv.step``.

        Args:
            actions: (n, J) integers in 0..6, or floats in -1 to 1.

        Raises:
            UserError: actions of the wrong shape or out of range; with autoreset disabled, a step
                in an environment whose episode has ended.
        """
        mode = self.metadata["autoreset_mode"]
        running = self.running
        restart = self._ended
        if mode == AutoresetMode.DISABLED and restart.any():
            raise UserError(
                f"Environment {int(np.argmax(restart))} has no running episode: reset it before "
                "the next step, one of several with options={'reset_mask': ...}."
            )
        self._move(actions)
        if mode == AutoresetMode.NEXT_STEP and restart.any():
            running.start_next(np.flatnonzero(restart))
        reward, terminated, truncated = self._outcome()
        if mode == AutoresetMode.NEXT_STEP:
            reward[restart] = 0.0
            terminated[restart] = False
            truncated[restart] = False
        ended = terminated | truncated
        final: Infos = {}
        if mode == AutoresetMode.SAME_STEP and ended.any():
            final = self._final_infos(ended)
            running.start_next(np.flatnonzero(ended))
            ended = np.zeros_like(ended)
        self._ended = ended
        return self._observe(), reward, terminated, truncated, self._infos() | final

    def advance(
        self, actions: ArrayLike, active: Mask, simulated: Mask | None = None
    ) -> Step:
        """Play one step and reset nothing; for playing a list of episodes to its end.

        The observations are images in any case.

        Args:
            actions: as in `step`.
            active: (n,) bool, the environments to draw; the images of the others are black.
            simulated: (n,) bool, the environments whose physics goes on; None: all.
        """
        self._move(actions, None if simulated is None else np.flatnonzero(simulated))
        reward, terminated, truncated = self._outcome()
        self._ended = terminated | truncated
        side = self.config.image_size
        images = np.zeros((self.num_envs, side, side, 3), np.uint8)
        ids = np.flatnonzero(active)
        if len(ids):
            images[ids] = draw_images(self.renderer, self.running, ids)
        return images, reward, terminated, truncated, self._infos()

    def go_on(self) -> None:
        """Let the episodes that have ended go on, where another limit of steps counts."""
        self._ended[:] = False

    def render(self) -> tuple[Images, ...]:
        """Draw the policy's view of each environment, enlarged: n images (480, 480, 3) uint8."""
        if self._large_renderer is None:
            self._large_renderer = make_renderer(self.scene, self.config, RENDER_SIZE)
        return tuple(draw_images(self._large_renderer, self.running))

    def get_state(self) -> NamedArrays:
        """Copy all that determines the following steps, to the byte."""
        return super().get_state() | {"ended": self._ended.copy()}

    def set_state(self, state: NamedArrays) -> None:
        """Restore a state of ``get_state``; see `BaseVectorEnv.set_state`."""
        # A torch environment resets all that have ended, and its state says nothing of them.
        arrays = dict(state)
        ended = arrays.pop("ended", np.zeros(self.num_envs, bool))
        super().set_state(arrays)
        self._ended = np.array(ended)

    def _out(self, array: Array) -> Array:
        return array.copy()

    def _outcome(self) -> tuple[Floats, Mask, Mask]:
        """Return reward, terminated and truncated, (n,) each, which the caller may write into."""
        outcome = self.running.outcome()
        return outcome.reward, outcome.terminated.copy(), outcome.truncated

    def _observe(self, ids: Indices | slice = slice(None)) -> Any:
        images = draw_images(self.renderer, self.running, ids)
        if isinstance(self.single_observation_space, spaces.Box):
            return images
        rows = self.running.knowledge_input[ids]
        return self._interface.observe(images, self.joint_positions[ids], rows)

    def _final_infos(self, ended: Mask) -> Infos:
        """Return last observations and metrics where episodes ended, as Gymnasium defines them."""
        ids = np.flatnonzero(ended)
        observations = np.full(self.num_envs, None)
        last = iterate(self.single_observation_space, self._observe(ids))
        observations[ids] = np.fromiter(last, object, len(ids))
        final = {}
        for name, values in self._infos().items():
            final[name] = np.zeros_like(values)
            final[name][ended] = values[ended]
        return {
            "final_obs": observations,
            "_final_obs": ended.copy(),
            "final_info": final,
            "_final_info": ended.copy(),
        }


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
