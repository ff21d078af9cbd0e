"""Policy agent: plays episodes of a vector environment with a policy."""

from typing import Any, Protocol

import numpy as np
import torch

from knowarm.policy.actions import greedy, sample
from knowarm.policy.policy import Policy


class FacetEnv(Protocol):
    """Members of a vector environment that `PolicyAgent` reads."""

    num_envs: int

    @property
    def facet_ids(self) -> Any:
        """Row of the knowledge table, (n,) int64, or knowledge, (n, K); array or tensor."""
        ...


class PolicyAgent:
    """Chooses actions with a policy and keeps its recurrent state.

    Call `start` after every reset of the environments, then `act` once per step.

    Args:
        policy: the policy, with its knowledge table; it is not changed.
        greedy: choose the most probable action instead of sampling.
        generator: samples the actions; required unless ``greedy``.
    """

    def __init__(
        self, policy: Policy, *, greedy: bool, generator: torch.Generator | None = None
    ) -> None:
        if not greedy and generator is None:
            raise ValueError("PolicyAgent(greedy=False) needs a generator to sample actions.")
        self.policy = policy
        self.greedy = greedy
        self.generator = generator

    def start(self, env: FacetEnv) -> None:
        """Reset the recurrent state: all episodes of ``env`` have just been reset."""
        self._env = env
        self._state = self.policy.initial_state(env.num_envs)
        self._episode_start = torch.ones(env.num_envs, dtype=torch.bool)

    def facets_for(self, observations: np.ndarray) -> torch.Tensor:
        """Return row (n,) int64, or knowledge (n, K) float32, of each episode."""
        return torch.as_tensor(self._env.facet_ids)

    @torch.inference_mode()
    def act(self, observations: np.ndarray) -> np.ndarray:
        """Choose actions.

        Args:
            observations: (n, H, W, 3) uint8.

        Returns:
            (n, J) int64 levels.
        """
        facet = self.facets_for(observations)
        image = torch.as_tensor(observations)
        logits, _, self._state = self.policy.step(image, facet, self._state, self._episode_start)
        self._episode_start = torch.zeros_like(self._episode_start)
        if self.greedy:
            return greedy(logits).numpy()
        assert self.generator is not None
        return sample(logits, self.generator).numpy()
