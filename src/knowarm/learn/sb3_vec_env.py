"""Stable-Baselines3 adapter: a ``VecEnv`` over a Gymnasium vector environment.

The only module of `knowarm.learn` that needs ``pip install 'knowarm[sb3]'``.
"""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import VectorEnv

from knowarm.errors import UserError, packages_of

with packages_of("sb3", "SB3VecEnv"):
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

Observations = np.ndarray | dict[str, np.ndarray]


class SB3VecEnv(VecEnv):
    """Vectorized ``VecEnv``: all environments advance in one call.

    Args:
        env: a vector environment with autoreset mode SAME_STEP; its observations may be a
            ``Dict``.
        seed: of the first reset.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        *,
        seed: int | None = None,
    ) -> None:
        if not isinstance(env, VectorEnv):
            raise UserError(
                f"SB3VecEnv needs a vector environment, got {type(env).__name__}: "
                'knowarm.make("irb120", num_envs=8).'
            )
        self.env = env  # read by the constructor of VecEnv, for its render_mode
        super().__init__(
            env.num_envs, env.single_observation_space, env.single_action_space
        )
        if seed is not None:
            self.seed(seed)
        self._actions = np.zeros(0)
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, np.int64)

    def reset(self) -> Observations:
        """Start new episodes; the first call uses the seed, of `VecEnv.seed` if that was called."""
        observations, _ = self.env.reset(seed=self._seeds[0])
        self._returns[:] = 0
        self._lengths[:] = 0
        self.reset_infos = [{} for _ in range(self.num_envs)]
        self._reset_seeds()
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Store the actions (n, J) for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Advance by one step.

        Where an episode ends, its info holds ``terminal_observation``, ``TimeLimit.truncated``,
        ``is_success``, and return and length as ``episode``, of which SB3 logs the means.
        """
        observations, rewards, terminated, truncated, infos = self.env.step(
            self._actions
        )
        done = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        info_of_env: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(done):
            info_of_env[i] = {
                "terminal_observation": infos["final_obs"][i],
                "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                "is_success": bool(infos["final_info"]["is_success"][i]),
                "episode": {"r": float(self._returns[i]), "l": int(self._lengths[i])},
            }
        self._returns[done] = 0
        self._lengths[done] = 0
        return observations, np.asarray(rewards, np.float32), done, info_of_env

    def close(self) -> None:
        """Close the vector environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the vector environment, repeated for each index."""
        return self._repeat(getattr(self.env, attr_name), indices)

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the vector environment."""
        setattr(self.env, attr_name, value)

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: Any = None,
        **method_kwargs: Any,
    ) -> list[Any]:
        """Call a method of the vector environment once; return its result for each index."""
        result = getattr(self.env, method_name)(*method_args, **method_kwargs)
        return self._repeat(result, indices)

    def env_is_wrapped(
        self,
        wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]],
        indices: Any = None,
    ) -> list[bool]:
        """Return for each index whether infos hold what a wrapper adds: true for `Monitor`."""
        return self._repeat(wrapper_class is Monitor, indices)

    def _repeat(self, value: Any, indices: Any) -> list[Any]:
        """Return a value once per index."""
        return [value for _ in self._get_indices(indices)]
