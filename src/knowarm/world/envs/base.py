"""Base of the vector environments: what they hold, and what they return in arrays or tensors."""

from typing import Any, Generic, TypeVar

import numpy as np
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.linalg import norm

from knowarm.arrays import Array, Images, Indices, Mask
from knowarm.errors import UserError, warn
from knowarm.world.config import EnvConfig, scene_of
from knowarm.world.envs.arguments import Options, Seeds
from knowarm.world.envs.interface import Interface
from knowarm.world.envs.running import RunningEpisodes
from knowarm.world.render.renderer import Renderer, make_renderer
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.state import NamedArrays

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
