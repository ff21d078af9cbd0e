"""Actions go in; images, rewards and infos of many reaching tasks at once come out."""

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from knowarm.errors import UserError
from knowarm.world.appearance import Appearance
from knowarm.world.arguments import check_state, checked_actions, masked_ids, spread_seeds
from knowarm.world.config import EnvConfig
from knowarm.world.episodes import Episodes, EpisodeSource
from knowarm.world.render.renderer import Renderer, make_renderer
from knowarm.world.rewards import is_success, measure, reward_terms
from knowarm.world.scene import Scene, load_scene, target_places
from knowarm.world.simulation import Simulation

__all__ = ["ACTION_LEVELS", "EnvConfig", "ReachVectorEnv"]

ACTION_LEVELS = (0.0, 1.0, -1.0, 0.1, -0.1, 0.01, -0.01)
"""Joint increments of the seven actions, in units of MPI (paper, table 1)."""

RENDER_SIZE = 480
"""Side of the images ``render`` returns [px]."""


class ReachVectorEnv(VectorEnv[NDArray[np.uint8], NDArray[np.int64], NDArray[Any]]):
    """n environments in which an arm reaches for one of several targets (paper, section 3).

    Observations are uint8 images (n, H, W, 3), actions int64 (n, J) that index
    ``ACTION_LEVELS``. Environment i of a vector seeded s plays the stream of episodes s + i, so an
    episode is the same at any n. Every array is new at every call and belongs to the caller.

    Infos are arrays (n,): distance [m], angle [deg], target and colour (indices), facet (index
    into ``facets``) and is_success, each with Gymnasium's mask ``_name``.

    Args:
        config: the task.
        num_envs: n.
        num_threads: threads of physics and images, 0 for one a core.
        autoreset: Gymnasium's mode; SAME_STEP also gives ``final_obs`` and ``final_info``.

    Attributes:
        images: what draws the observations; anything with its ``draw`` may take its place.
        facets: (target, colour) names, targets in config order, colours in theirs.
        facet_ids: facet of the episode now running, (n,) int64.
    """

    def __init__(
        self,
        config: EnvConfig,
        num_envs: int,
        num_threads: int = 0,
        autoreset: AutoresetMode = AutoresetMode.SAME_STEP,
        render_mode: str | None = None,
    ) -> None:
        if num_envs < 1:
            raise UserError(f"num_envs must be at least 1, got {num_envs}.")
        self.config = config
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": 10,
            "autoreset_mode": autoreset,
        }
        self.scene: Scene = load_scene(
            config.robot, tuple(config.targets), config.randomization.distractors
        )
        self.simulation = Simulation(self.scene, num_envs, num_threads, config.dynamics)
        self.renderer: Renderer = make_renderer(self.scene, config, config.image_size, num_threads)
        self._large_renderer: Renderer | None = None
        self._increments = config.mpi_rad * np.array(ACTION_LEVELS)
        self.facets, self._first_facet = list_facets(self.scene, config)

        self._image_shape = (config.image_size, config.image_size, 3)
        self.single_observation_space = spaces.Box(0, 255, self._image_shape, np.uint8)
        self.single_action_space = spaces.MultiDiscrete(
            np.full(self.scene.num_joints, len(ACTION_LEVELS))
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

        n, joints = num_envs, self.scene.num_joints
        self._streams: NDArray[np.uint64] = (
            np.random.SeedSequence().generate_state(n, np.uint64).astype(np.uint64)
        )
        self._next_episode = np.zeros(n, dtype=np.uint64)
        self._steps = np.zeros(n, dtype=np.int64)
        self._ended = np.ones(n, dtype=np.bool_)
        self._joint_targets = np.zeros((n, joints))
        self._target = np.zeros(n, dtype=np.int64)
        self._colour = np.zeros(n, dtype=np.int64)
        self._position = np.zeros((n, 2))
        self._look = np.zeros((n, config.randomization.draws))
        self._grasp_position = np.zeros((n, 3))
        self._grasp_matrix = np.zeros((n, 9))
        self._appearance = Appearance(self.scene, config.randomization, n)
        self._episodes = EpisodeSource(self.scene, config)
        self._show(np.arange(n))
        self._measure()

    @property
    def joint_positions(self) -> NDArray[np.float64]:
        """Joint angles as they are now, (n, J) [rad]."""
        return self.simulation.joint_positions

    @property
    def target(self) -> NDArray[np.int64]:
        """Index of each environment's target, (n,)."""
        return self._target.copy()

    @property
    def colour(self) -> NDArray[np.int64]:
        """Index of each environment's colour among its target's, (n,)."""
        return self._colour.copy()

    @property
    def geom_rgba(self) -> NDArray[np.float32]:
        """Colour of every geom, alpha 0 where it is hidden, (n, G, 4)."""
        return self._appearance.rgba.copy()

    @property
    def joint_targets(self) -> NDArray[np.float64]:
        """Where the servos are sent, (n, J) [rad]; actions add to it."""
        return self._joint_targets.copy()

    @property
    def grasp_position(self) -> NDArray[np.float64]:
        """Grasp point of each environment, world, (n, 3) [m]: for scripted agents."""
        return self._grasp_position.copy()

    @property
    def grasp_matrix(self) -> NDArray[np.float64]:
        """Rotation from grasp frame to world, row by row, (n, 9): for scripted agents."""
        return self._grasp_matrix.copy()

    @property
    def facet_ids(self) -> NDArray[np.int64]:
        """Facet of the episode now running, (n,)."""
        return self._first_facet[self._target] + self._colour

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        """Start a new episode in every environment, or in those of a mask.

        Args:
            seed: stream of the first environment (the others follow), or one a environment; None
                goes on in the present streams.
            options: "episodes", the ``Episodes`` to play instead of drawn ones, one for each
                environment that is reset; "reset_mask", (n,) bool, the environments to reset.

        Raises:
            UserError: a seed, mask or list of episodes of another length.
        """
        options = options or {}
        ids = masked_ids(options.get("reset_mask"), self.num_envs)
        seeds = spread_seeds(seed, self.num_envs)
        seeded = ids[seeds.given[ids]]
        self._streams[seeded] = seeds.values[seeded]
        self._next_episode[seeded] = 0
        episodes = options.get("episodes")
        if episodes is None:
            self._start_next(ids)
        elif len(episodes) == len(ids):
            self._start(ids, episodes)
        else:
            raise UserError(
                f"options['episodes'] holds {len(episodes)} episodes for {len(ids)} environments "
                "that are reset; give one each."
            )
        self._measure()
        return self._render_images(), self._infos()

    def step(
        self, actions: ArrayLike
    ) -> tuple[
        NDArray[np.uint8],
        NDArray[np.float64],
        NDArray[np.bool_],
        NDArray[np.bool_],
        dict[str, Any],
    ]:
        """Play one step in every environment; see Gymnasium's ``VectorEnv.step``.

        Args:
            actions: (n, J) integers in 0..6.

        Raises:
            UserError: actions of another shape or outside 0..6; with autoreset off, a step in an
                environment that has ended.
        """
        mode = self.metadata["autoreset_mode"]
        restart = self._ended.copy()
        if mode == AutoresetMode.DISABLED and restart.any():
            raise UserError(
                f"Environment {int(np.argmax(restart))} has ended; reset it before the next step "
                "(options={'reset_mask': ...}), or use another autoreset mode."
            )
        self._move(actions)
        if mode == AutoresetMode.NEXT_STEP and restart.any():
            self._start_next(np.flatnonzero(restart))
            self._measure()
        rewards, terminated, truncated = self._judge()
        if mode == AutoresetMode.NEXT_STEP:
            rewards[restart], terminated[restart], truncated[restart] = 0.0, False, False
        self._ended = terminated | truncated

        final: dict[str, Any] = {}
        if mode == AutoresetMode.SAME_STEP and self._ended.any():
            final = self._final_infos(self._ended)
            self._start_next(np.flatnonzero(self._ended))
            self._measure()
        return self._render_images(), rewards, terminated, truncated, self._infos() | final

    def advance(
        self, actions: ArrayLike, active: NDArray[np.bool_]
    ) -> tuple[
        NDArray[np.uint8],
        NDArray[np.float64],
        NDArray[np.bool_],
        NDArray[np.bool_],
        dict[str, Any],
    ]:
        """Play one step and reset nothing: for playing a list of episodes to its end.

        Args:
            actions: (n, J) integers in 0..6.
            active: (n,) bool, the environments whose images are wanted; the others' are black.
        """
        self._move(actions)
        rewards, terminated, truncated = self._judge()
        self._ended = terminated | truncated
        images = np.zeros((self.num_envs, *self._image_shape), dtype=np.uint8)
        ids = np.flatnonzero(active)
        if len(ids):
            images[ids] = self._render_images(ids)
        return images, rewards, terminated, truncated, self._infos()

    def render(self) -> tuple[NDArray[np.uint8], ...]:
        """Draw the policy's view of each environment, large: n images (480, 480, 3) uint8."""
        if self._large_renderer is None:
            self._large_renderer = make_renderer(self.scene, self.config, RENDER_SIZE)
        simulation = self.simulation
        return tuple(
            self._large_renderer.draw(
                simulation.geom_position,
                simulation.geom_matrix,
                *self._appearance.of(slice(None)),
            )
        )

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Copy everything that is needed to go on to the byte."""
        state = {name: getattr(self, f"_{name}").copy() for name in _STATE}
        return state | {"simulation": self.simulation.get_state()}

    def set_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Go on from a state of ``get_state``, of an environment with the same config and n.

        Raises:
            UserError: the state is another kind of environment's.
        """
        check_state(self.get_state(), state)
        for name in _STATE:
            setattr(self, f"_{name}", np.asarray(state[name]).copy())
        self.simulation.set_state(state["simulation"])
        self._show(np.arange(self.num_envs))
        self._measure()

    def _start_next(self, ids: NDArray[np.intp]) -> None:
        """Start the next drawn episode of each environment's stream."""
        streams, numbers = self._streams[ids], self._next_episode[ids]
        self._next_episode[ids] += np.uint64(1)
        self._start(ids, self._episodes(streams, numbers))

    def _start(self, ids: NDArray[np.intp], episodes: Episodes) -> None:
        """Put environments at the start of given episodes."""
        self._appearance.check(episodes)
        joints = np.clip(
            self.scene.home + episodes.joint_offsets,
            self.scene.joint_lower,
            self.scene.joint_upper,
        )
        self._joint_targets[ids] = joints
        self._target[ids] = episodes.target
        self._colour[ids] = episodes.colour
        self._position[ids] = episodes.position
        self._look[ids] = episodes.look
        self._steps[ids] = 0
        self._ended[ids] = False
        distractors = self._show(ids)
        self.simulation.reset(ids, joints, episodes.position, distractors)

    def _show(self, ids: NDArray[np.intp]) -> NDArray[np.float64] | None:
        """Bring grasp frames and looks in line with the episodes; places of distractors."""
        scene, target = self.scene, self._target[ids]
        places = target_places(scene, self._position[ids])
        self._grasp_position[ids] = places + scene.grasp_position[target]
        self._grasp_matrix[ids] = scene.grasp_matrix[target].reshape(-1, 9)
        running = Episodes(
            self._joint_targets[ids],
            target,
            self._position[ids],
            self._colour[ids],
            self._look[ids],
        )
        return self._appearance.show(ids, running)

    def _move(self, actions: ArrayLike) -> None:
        """Add the increments to the joint targets and follow them for one control period."""
        levels = checked_actions(actions, self._joint_targets.shape, len(ACTION_LEVELS))
        targets = self._joint_targets + self._increments[levels]
        self._joint_targets = np.clip(targets, self.scene.joint_lower, self.scene.joint_upper)
        self.simulation.step(self._joint_targets)
        self._steps += 1
        self._measure()

    def _judge(self) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
        """Reward, terminated and truncated of every environment as it is now, (n,) each."""
        terms = reward_terms(self._distance, self._angle, self._success)
        truncated = (self._steps >= self.config.max_episode_steps) & ~self._success
        return np.sum(list(terms.values()), axis=0), self._success.copy(), truncated

    def _measure(self) -> None:
        """Measure distance [m], angle [deg] and success of every environment as it is now."""
        simulation, config = self.simulation, self.config
        self._distance, self._angle = measure(
            simulation.tcp_position,
            simulation.tcp_matrix,
            self._grasp_position,
            self._grasp_matrix,
            config.ignore_roll,
        )
        self._success = is_success(
            self._distance, self._angle, config.success_distance_m, config.success_angle_deg
        )

    def _render_images(self, ids: NDArray[np.intp] | slice = slice(None)) -> NDArray[np.uint8]:
        simulation = self.simulation
        return self.renderer.draw(
            simulation.geom_position[ids], simulation.geom_matrix[ids], *self._appearance.of(ids)
        )

    def _infos(self) -> dict[str, Any]:
        """Metrics of the state as it is now, each with its mask."""
        infos: dict[str, Any] = {
            "distance": self._distance,
            "angle": self._angle,
            "target": self._target.copy(),
            "colour": self._colour.copy(),
            "facet": self.facet_ids,
            "is_success": self._success,
        }
        everywhere = np.ones(self.num_envs, dtype=np.bool_)
        return infos | {f"_{name}": everywhere for name in infos}

    def _final_infos(self, ended: NDArray[np.bool_]) -> dict[str, Any]:
        """Last images and metrics of the episodes that ended, as Gymnasium documents them."""
        ids = np.flatnonzero(ended)
        images = np.full(self.num_envs, None, dtype=object)
        images[ids] = np.fromiter(self._render_images(ids), dtype=object, count=len(ids))
        infos = self._infos()
        final = {
            name: np.where(ended, values, 0).astype(values.dtype) for name, values in infos.items()
        }
        return {
            "final_obs": images,
            "_final_obs": ended.copy(),
            "final_info": final,
            "_final_info": ended.copy(),
        }


_STATE = (
    "streams",
    "next_episode",
    "steps",
    "ended",
    "joint_targets",
    "target",
    "colour",
    "position",
    "look",
)
"""Arrays of ``ReachVectorEnv`` that, with the simulation's state, determine everything else."""


def list_facets(
    scene: Scene, config: EnvConfig
) -> tuple[tuple[tuple[str, str], ...], NDArray[np.int64]]:
    """List the (target, colour) pairs of a config, and the index of each target's first."""
    facets: list[tuple[str, str]] = []
    first = []
    for target in scene.targets:
        colours = list(target.colours) if config.colours == "randomized" else [*target.colours][:1]
        first.append(len(facets))
        facets += [(target.name, colour) for colour in colours]
    return tuple(facets), np.array(first, dtype=np.int64)
