"""NumPy vector environment: Gymnasium's ``VectorEnv`` on MuJoCo."""

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space, iterate
from numpy.typing import ArrayLike

from knowarm.arrays import Array, Floats, Images, Indices, Mask
from knowarm.errors import UserError
from knowarm.world.config import EnvConfig
from knowarm.world.envs.base import Action, BaseVectorEnv, Infos, Observe, draw_images
from knowarm.world.render.renderer import Renderer, make_renderer
from knowarm.world.tasks.state import NamedArrays

RENDER_SIZE = 480  # Width and height of the images that ``render`` returns [px]
Step = tuple[Any, Floats, Mask, Mask, Infos]
"""Observations (n, ...), reward (n,), terminated (n,), truncated (n,) and infos."""


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

    def advance(self, actions: ArrayLike, active: Mask) -> Step:
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
