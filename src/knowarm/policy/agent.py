"""A policy and a knowledge table go in; an agent that plays episodes comes out."""

from typing import Protocol

import numpy as np
import torch

from knowarm.policy.actions import greedy, sample
from knowarm.policy.policy import Policy


class FacetEnv(Protocol):
    """What a policy needs to know of a vector environment."""

    num_envs: int

    @property
    def facet_ids(self) -> np.ndarray:
        """(n,) int64: which row of the knowledge table belongs to each running episode."""
        ...


class PolicyAgent:
    """Plays a policy; `start` at the beginning of episodes, then `act` once a step.

    Args:
        policy: the policy; it is not changed.
        knowledge_table: (F, K) float32, one row a facet.
        greedy: take the most probable action instead of drawing one.
        generator: draws the actions; needed unless ``greedy``.
    """

    def __init__(
        self,
        policy: Policy,
        knowledge_table: np.ndarray,
        *,
        greedy: bool,
        generator: torch.Generator | None = None,
    ) -> None:
        assert greedy or generator is not None, "drawing actions needs a generator"
        self.policy = policy
        self.greedy = greedy
        self.generator = generator
        self._table = torch.tensor(knowledge_table, dtype=torch.float32)

    @classmethod
    def seeded(
        cls, policy: Policy, knowledge_table: np.ndarray, *, greedy: bool, seed: int
    ) -> "PolicyAgent":
        """Make an agent with a fresh generator of its own."""
        generator = torch.Generator().manual_seed(seed)
        return cls(policy, knowledge_table, greedy=greedy, generator=generator)

    def start(self, env: FacetEnv) -> None:
        """Forget the past: all episodes of ``env`` were just reset."""
        self._env = env
        self._state = self.policy.initial_state(env.num_envs)
        self._first = torch.ones(env.num_envs, dtype=torch.bool)

    @torch.inference_mode()
    def act(self, observations: np.ndarray) -> np.ndarray:
        """Choose actions.

        Args:
            observations: (n, H, W, 3) uint8.

        Returns:
            (n, J) int64 levels.
        """
        knowledge = self._table[torch.as_tensor(self._env.facet_ids)]
        patches = self.policy.patches(torch.as_tensor(observations))
        logits, _, self._state = self.policy.step(patches, knowledge, self._state, self._first)
        self._first = torch.zeros_like(self._first)
        if self.greedy:
            return greedy(logits).numpy()
        assert self.generator is not None
        return sample(logits, self.generator).numpy()
