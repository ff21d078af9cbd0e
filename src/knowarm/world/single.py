"""One action goes in; one image and reward come out: Gymnasium's plain ``Env``."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.config import EnvConfig
from knowarm.world.env import ReachVectorEnv


class ReachEnv(gymnasium.Env[NDArray[np.uint8], NDArray[np.int64]]):
    """A reaching task as ``gymnasium.make`` gives it: ``ReachVectorEnv`` with n = 1.

    Args:
        render_mode: "rgb_array" lets ``render`` return a large image; None draws none.
        options: fields of ``EnvConfig``.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 (Gymnasium's name)

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        if render_mode not in (None, "rgb_array"):
            raise UserError(f"render_mode must be 'rgb_array' or None, got {render_mode!r}.")
        self.render_mode = render_mode
        self._vector = ReachVectorEnv(
            EnvConfig(**options), 1, num_threads=1, autoreset=AutoresetMode.DISABLED
        )
        self.config = self._vector.config
        self.facets = self._vector.facets
        self.observation_space = self._vector.single_observation_space
        self.action_space = self._vector.single_action_space

    @property
    def joint_positions(self) -> NDArray[np.float64]:
        """Joint angles as they are now, (J,) [rad]."""
        return self._vector.joint_positions[0]

    @property
    def facet_id(self) -> int:
        """Index into ``facets`` of the episode now running."""
        return int(self._vector.facet_ids[0])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        """Start a new episode; options may hold "episodes", an ``Episodes`` of length 1."""
        super().reset(seed=seed)
        images, infos = self._vector.reset(seed=seed, options=options)
        return images[0], _first(infos)

    def step(
        self, action: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        """Play one step; action is (J,) integers in 0..6."""
        images, rewards, terminated, truncated, infos = self._vector.step(np.asarray(action)[None])
        return (
            images[0],
            float(rewards[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            _first(infos),
        )

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the policy's view at 480 x 480, uint8; None without render mode."""
        return self._vector.render()[0] if self.render_mode else None


def make_vector_env(
    num_envs: int,
    num_threads: int = 0,
    autoreset: AutoresetMode = AutoresetMode.SAME_STEP,
    render_mode: str | None = None,
    device: str | None = None,
    **options: Any,
) -> VectorEnv[Any, Any, Any]:
    """Build the vector environment: the ``make_vec`` entry point.

    Args:
        num_envs: n.
        num_threads: threads of physics and images, 0 for one a core.
        autoreset: Gymnasium's mode.
        render_mode: "rgb_array", or None.
        device: None for ``ReachVectorEnv``, which takes and gives NumPy arrays; "cuda", or "cpu"
            for checking, for ``DeviceReachVectorEnv``, which takes and gives torch tensors.
        options: fields of ``EnvConfig``.

    Raises:
        UserError: a device together with what only NumPy's environment has.
    """
    config = EnvConfig(**options)
    if device is None:
        return ReachVectorEnv(config, num_envs, num_threads, autoreset, render_mode)
    if (num_threads, autoreset, render_mode) != (0, AutoresetMode.SAME_STEP, None):
        raise UserError(
            f"With device {device!r} environments begin anew in the same step, without threads and "
            f"large images; got num_threads {num_threads}, autoreset {autoreset.value} and "
            f"render_mode {render_mode!r}. Leave these out, or leave out device."
        )
    # Torch and Warp take seconds to import; NumPy's environment needs neither.
    from knowarm.world.gpu.env import DeviceReachVectorEnv

    return DeviceReachVectorEnv(config, num_envs, device)


def _first(infos: dict[str, Any]) -> dict[str, Any]:
    """Take the only environment's values, as plain Python numbers, and leave the masks out."""
    return {name: values[0].item() for name, values in infos.items() if not name.startswith("_")}
