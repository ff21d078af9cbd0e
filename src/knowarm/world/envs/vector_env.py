"""NumPy vector environment: Gymnasium's ``VectorEnv`` on MuJoCo."""

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, iterate
from numpy.typing import ArrayLike, NDArray

from knowarm.errors import UserError
from knowarm.world.config import EnvConfig, scene_of
from knowarm.world.envs.arguments import check_state
from knowarm.world.envs.interface import Action, Interface, Observe
from knowarm.world.envs.running import RunningEpisodes
from knowarm.world.render.renderer import Renderer, make_renderer
from knowarm.world.scene.scene import Scene

RENDER_SIZE = 480  # Width and height of the images that ``render`` returns [px]
Step = tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]
"""Observations (n, ...), reward (n,), terminated (n,), truncated (n,) and infos."""


class ArmVectorEnv(VectorEnv[Any, NDArray[Any], NDArray[Any]]):
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
        autoreset: Gymnasium's mode; SAME_STEP adds ``final_obs`` and ``final_info``.
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
        autoreset: AutoresetMode = AutoresetMode.SAME_STEP,
        render_mode: str | None = None,
        *,
        action: Action = "levels",
        observe: Observe = "image",
        knowledge: ArrayLike | None = None,
    ) -> None:
        self.config = config
        self.scene, self._interface = describe(self, config, num_envs, action, observe, knowledge)
        self.render_mode = render_mode
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": 10,
            "autoreset_mode": AutoresetMode(autoreset),  # or its value
        }
        self.simulation = config.task.simulator(self.scene, num_envs, num_threads, config.dynamics)
        self.renderer: Renderer = make_renderer(self.scene, config, config.image_size, num_threads)
        self._large_renderer: Renderer | None = None
        self.running = RunningEpisodes(config, self.simulation)
        self.facets = self.running.facets
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._ended = np.ones(num_envs, dtype=np.bool_)

    @property
    def joint_positions(self) -> NDArray[np.float64]:
        """Current joint angles, (n, J) [rad]."""
        return self.simulation.joint_positions

    @property
    def joint_targets(self) -> NDArray[np.float64]:
        """Joint angles that the servos track, (n, J) [rad]; actions add to them."""
        return self.running.joint_targets.copy()

    @property
    def knowledge_input(self) -> NDArray[np.int64]:
        """Row of the knowledge table for each current episode, (n,): facet, or query."""
        return self.running.knowledge_input

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start a new episode in every environment, or in those of a mask.

        Args:
            seed: stream of the first environment (the others follow), or one per environment;
                None continues the current streams.
            options: "episodes", the ``Episodes`` to play instead of drawn ones, one for each
                environment that is reset; "reset_mask", (n,) bool, the environments to reset.

        Raises:
            UserError: a seed, mask or list of episodes of the wrong length.
        """
        self._ended[self.running.reset(seed, options)] = False
        return self._observe(), self._infos()

    def step(self, actions: ArrayLike) -> Step:
        """Play one step in every environment; see Gymnasium's ``VectorEnv.step``.

        Args:
            actions: (n, J) integers in 0..6, or floats in -1 to 1.

        Raises:
            UserError: actions of the wrong shape or out of range; with autoreset disabled, a step
                in an environment whose episode has ended.
        """
        mode = self.metadata["autoreset_mode"]
        running, restart = self.running, self._ended
        if mode == AutoresetMode.DISABLED and restart.any():
            raise UserError(
                f"Environment {int(np.argmax(restart))} has ended; reset it before the next step "
                "(options={'reset_mask': ...}), or use another autoreset mode."
            )
        self._move(actions)
        if mode == AutoresetMode.NEXT_STEP and restart.any():
            running.start_next(np.flatnonzero(restart))
        reward, terminated, truncated = self._outcome()
        if mode == AutoresetMode.NEXT_STEP:
            reward[restart], terminated[restart], truncated[restart] = 0.0, False, False
        ended = terminated | truncated
        final: dict[str, Any] = {}
        if mode == AutoresetMode.SAME_STEP and ended.any():
            final = self._final_infos(ended)
            running.start_next(np.flatnonzero(ended))
            ended = np.zeros_like(ended)
        self._ended = ended
        return self._observe(), reward, terminated, truncated, self._infos() | final

    def advance(self, actions: ArrayLike, active: NDArray[np.bool_]) -> Step:
        """Play one step and reset nothing; for playing a list of episodes to its end.

        The observations are images in any case.

        Args:
            actions: as in `step`.
            active: (n,) bool, the environments to draw; the images of the others are black.
        """
        self._move(actions)
        reward, terminated, truncated = self._outcome()
        self._ended = terminated | truncated
        side = self.config.image_size
        images = np.zeros((self.num_envs, side, side, 3), dtype=np.uint8)
        ids = np.flatnonzero(active)
        if len(ids):
            images[ids] = self._render_images(ids)
        return images, reward, terminated, truncated, self._infos()

    def render(self) -> tuple[NDArray[np.uint8], ...]:
        """Draw the policy's view of each environment, enlarged: n images (480, 480, 3) uint8."""
        if self._large_renderer is None:
            self._large_renderer = make_renderer(self.scene, self.config, RENDER_SIZE)
        return tuple(draw_images(self._large_renderer, self.running))

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Copy all that determines the following steps, to the byte."""
        return self.running.get_state() | {"ended": self._ended.copy()}

    def set_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore a state of ``get_state``, of an environment with the same config and n.

        Raises:
            UserError: the state belongs to another kind of environment.
        """
        check_state(self.get_state(), state)
        self.running.set_state({name: values for name, values in state.items() if name != "ended"})
        self._ended = np.array(state["ended"])

    def _move(self, actions: ArrayLike) -> None:
        running = self.running
        running.move(self._interface.steps(actions, self.num_envs, running.increments))

    def _outcome(self) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
        """Return reward, terminated and truncated, (n,) each, which the caller may write into."""
        outcome = self.running.outcome()
        return outcome.reward, outcome.terminated.copy(), outcome.truncated

    def _observe(self, ids: NDArray[np.intp] | slice = slice(None)) -> Any:
        images = self._render_images(ids)
        if isinstance(self.single_observation_space, spaces.Box):
            return images
        joints, rows = self.joint_positions[ids], self.running.knowledge_input[ids]
        return self._interface.observe(images, joints, rows)

    def _render_images(self, ids: NDArray[np.intp] | slice = slice(None)) -> NDArray[np.uint8]:
        return draw_images(self.renderer, self.running, ids)

    def _infos(self) -> dict[str, Any]:
        """Copy the metrics of the current state, each with its mask."""
        infos = {name: values.copy() for name, values in self.running.infos().items()}
        masks = [f"_{name}" for name in infos]
        return infos | dict.fromkeys(masks, np.ones(self.num_envs, dtype=np.bool_))

    def _final_infos(self, ended: NDArray[np.bool_]) -> dict[str, Any]:
        """Return last observations and metrics where episodes ended, as Gymnasium defines them."""
        ids = np.flatnonzero(ended)
        observations = np.full(self.num_envs, None, dtype=object)
        last = iterate(self.single_observation_space, self._observe(ids))
        observations[ids] = np.fromiter(last, dtype=object, count=len(ids))
        final = {
            name: np.where(
                ended[(...,) + (None,) * (values.ndim - 1)], values, np.zeros((), values.dtype)
            )
            for name, values in self._infos().items()
        }
        return {
            "final_obs": observations,
            "_final_obs": ended.copy(),
            "final_info": final,
            "_final_info": ended.copy(),
        }


def describe(
    env: Any, config: EnvConfig, num_envs: int, *interface: Any
) -> tuple[Scene, Interface]:
    """Load the scene of a config and set the attributes that both vector environments have."""
    if num_envs < 1:
        raise UserError(f"num_envs must be at least 1, got {num_envs}.")
    scene = scene_of(config)
    described = Interface(config, scene.num_joints, *interface)
    env.num_envs = num_envs
    env.single_observation_space = described.observation_space
    env.single_action_space = described.action_space
    env.action_space = batch_space(env.single_action_space, num_envs)
    return scene, described


def draw_images(
    renderer: Renderer, running: RunningEpisodes, env_ids: NDArray[np.intp] | slice = slice(None)
) -> NDArray[np.uint8]:
    """Draw environments of a task, (k, H, W, 3) uint8, a new array."""
    simulator, shown = running.simulator, running.shown
    return renderer.draw(
        simulator.geom_position[env_ids],
        simulator.geom_matrix[env_ids],
        shown.rgba[env_ids],
        None if shown.views is None else shown.views[env_ids],
        None if shown.lamps is None else shown.lamps[env_ids],
    )
