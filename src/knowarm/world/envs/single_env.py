"""Single environment, and what makes vector environments by options."""

import dataclasses
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import iterate
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, TimeLimit

from knowarm.arrays import Array, Floats, Images
from knowarm.errors import UserError, unknown_name
from knowarm.world.config import EnvConfig
from knowarm.world.envs.running import Options
from knowarm.world.envs.vector_env import ArmVectorEnv, Infos
from knowarm.world.tasks.state import NamedArrays

INTERFACE = ("action", "observe", "knowledge")
"""Options of ``ArmVectorEnv`` besides the fields of ``EnvConfig``."""


VECTOR_OPTIONS = ("autoreset_mode", "device", "num_threads")
"""Further options of vector environments."""


class ArmEnv(gymnasium.Env[Any, Array]):
    """An environment as ``gymnasium.make`` returns it: ``ArmVectorEnv`` with n = 1.

    Args:
        render_mode: "rgb_array" to draw enlarged images with ``render``, or None.
        options: fields of ``EnvConfig``; and ``action``, ``observe`` and ``knowledge``, as those of
            ``ArmVectorEnv``.

    Attributes:
        vector: the environment as a vector environment with n = 1.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 (Gymnasium's name)

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        if render_mode not in (None, "rgb_array"):
            raise UserError(
                f"render_mode must be 'rgb_array' or None, got {render_mode!r}."
            )
        self.render_mode = render_mode
        for name in VECTOR_OPTIONS:
            if name in options:
                raise UserError(
                    f"{name} is an option of vector environments, and this is a single one; pass "
                    f"num_envs as well, or leave out {name}."
                )
        config, interface = env_config(("render_mode",), options)
        self.vector = ArmVectorEnv(config, 1, 1, AutoresetMode.DISABLED, **interface)
        self.config = self.vector.config
        self.facets = self.vector.facets
        self.observation_space = self.vector.single_observation_space
        self.action_space = self.vector.single_action_space

    @property
    def knowledge_input(self) -> int:
        """Row of the knowledge table for the current episode: facet, or query."""
        return int(self.vector.knowledge_input[0])

    @property
    def instruction(self) -> str:
        """Goal of the current episode in words that a policy may know; see `Task.instruct`."""
        return self.vector.running.instruct(0)

    @property
    def joint_targets(self) -> Floats:
        """Joint angles that the servos track, (J,) [rad]; actions add to them."""
        return self.vector.joint_targets[0]

    @property
    def joint_positions(self) -> Floats:
        """Current joint angles, (J,) [rad]."""
        return self.vector.joint_positions[0]

    def reset(
        self, *, seed: int | None = None, options: Options | None = None
    ) -> tuple[Any, Infos]:
        """Start a new episode; ``options["episodes"]`` may be an ``Episodes`` of length 1."""
        super().reset(seed=seed)
        observations, infos = self.vector.reset(seed=seed, options=options)
        return self._only(observations), _first(infos)

    def step(self, action: Array) -> tuple[Any, float, bool, bool, Infos]:
        """Play one step with an action of (J,) integers in 0..6, or floats in -1 to 1."""
        actions = np.asarray(action)[None]
        observations, rewards, terminated, truncated, infos = self.vector.step(actions)
        return (
            self._only(observations),
            float(rewards[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            _first(infos),
        )

    def get_state(self) -> NamedArrays:
        """Copy all that determines the following steps, to the byte; for planning."""
        return self.vector.get_state()

    def set_state(self, state: NamedArrays) -> None:
        """Restore a state of ``get_state``, of an environment with the same config.

        Raises:
            UserError: the state belongs to another kind of environment.
        """
        self.vector.set_state(state)

    def _only(self, observations: Any) -> Any:
        return next(iter(iterate(self.observation_space, observations)))

    def render(self) -> Images | None:
        """Draw the policy's view, (480, 480, 3) uint8; None without a render mode."""
        if self.render_mode is None:
            return None
        return self.vector.render()[0]


def vector_of(env: Any) -> ArmVectorEnv:
    """Return an environment that an agent can play as the vector environment that it is or holds.

    Raises:
        UserError: it is another one, or a wrapper may change what the agent sees or does.
    """
    inner = env
    while isinstance(inner, _HARMLESS) or _has_own_limit(inner):
        inner = inner.env
    if isinstance(inner, ArmEnv):
        return inner.vector
    if isinstance(inner, ArmVectorEnv):
        return inner
    raise UserError(
        "Agents play an ArmEnv or ArmVectorEnv without further wrappers, as knowarm.make and "
        "gymnasium.make return them (another limit of steps is knowarm.make's max_episode_steps), "
        f"got {type(inner).__name__}."
    )


_HARMLESS = (OrderEnforcing, PassiveEnvChecker)
"""Wrappers that `gymnasium.make` adds, and that change nothing."""


def _has_own_limit(env: Any) -> bool:
    """Return whether an environment is wrapped by the limit of steps that its config has."""
    if not (isinstance(env, TimeLimit) and isinstance(env.unwrapped, ArmEnv)):
        return False
    steps = env.unwrapped.config.max_episode_steps
    return env.spec is not None and env.spec.max_episode_steps == steps


def env_config(others: tuple[str, ...], options: Options) -> tuple[EnvConfig, Options]:
    """Return the config of an environment, and the options of its interface.

    An error names also the ``others``, which the caller has taken.
    """
    fields = [field.name for field in dataclasses.fields(EnvConfig)]
    known = [*fields, *INTERFACE]
    for name in options:
        if name not in known:
            raise unknown_name("option of an environment", name, [*known, *others])
    interface = {name: options.pop(name) for name in INTERFACE if name in options}
    return EnvConfig(**options), interface


def make_vector_env(
    num_envs: int,
    num_threads: int = 0,
    autoreset_mode: AutoresetMode = AutoresetMode.SAME_STEP,
    render_mode: str | None = None,
    device: str | None = None,
    **options: Any,
) -> VectorEnv[Any, Any, Any]:
    """Create a vector environment.

    Args:
        num_envs: n.
        num_threads: threads of physics and rendering; 0 for one per core.
        autoreset_mode: Gymnasium's.
        render_mode: "rgb_array", or None.
        device: None for ``ArmVectorEnv``, with NumPy arrays; "cpu" or "cuda" for
            ``TorchArmVectorEnv``, with tensors on that device.
        options: fields of ``EnvConfig``, and those of ``ArmVectorEnv``.

    Raises:
        UserError: a device is combined with an argument of the NumPy environment.
    """
    config, interface = env_config(("render_mode", *VECTOR_OPTIONS), options)
    if device is None:
        return ArmVectorEnv(
            config, num_envs, num_threads, autoreset_mode, render_mode, **interface
        )
    if interface:
        raise UserError(
            f"With device {device!r} observations are images and actions are levels; a policy "
            f"holds the knowledge table. Leave out {', '.join(interface)}, or device."
        )
    mode = AutoresetMode(autoreset_mode)
    if (mode, render_mode) != (AutoresetMode.SAME_STEP, None):
        raise UserError(
            f"With device {device!r} environments are reset in the same step and have no render "
            f"mode; got autoreset_mode {mode.value!r} and render_mode {render_mode!r}. Leave "
            "these out, or leave out device."
        )
    # Importing torch takes seconds, and the NumPy environment does not need it.
    from knowarm.world.envs.torch_env import TorchArmVectorEnv

    return TorchArmVectorEnv(config, num_envs, device=device, num_threads=num_threads)


def _first(infos: Infos) -> Infos:
    """Return the infos of environment 0 as Python values or arrays, without the masks."""
    first = {}
    for name, values in infos.items():
        if not name.startswith("_"):
            first[name] = values[0].copy() if values.ndim > 1 else values[0].item()
    return first
