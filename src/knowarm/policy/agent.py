"""Policy agent: plays episodes of a vector environment with a policy."""

from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from knowarm.policy.policy import Policy, State, sample


class FacetEnv(Protocol):
    """Members of a vector environment that `PolicyAgent` reads."""

    num_envs: int

    @property
    def knowledge_input(self) -> Any:
        """Row of the knowledge table, (n,) int64, or knowledge, (n, K); array or tensor."""


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

    def knowledge_input(self, observations: np.ndarray) -> torch.Tensor:
        """Return row (n,) int64, or knowledge (n, K) float32, of each episode."""
        return torch.as_tensor(self._env.knowledge_input)

    @torch.inference_mode()
    def choose(
        self, images: Tensor, knowledge: Tensor, state: State, episode_start: Tensor
    ) -> tuple[np.ndarray, State]:
        """Choose the actions of one step; return levels (n, J) int64 and the next recurrent state.

        ``images`` are (n, H, W, 3) uint8, ``knowledge`` is as `knowledge_input` returns it, and
        ``episode_start`` (n,) bool tells whether the step is the first of its episode.
        """
        logits, _, state = self.policy.step(images, knowledge, state, episode_start)
        if self.greedy:
            return logits.argmax(-1).numpy(), state
        assert self.generator is not None
        return sample(logits, self.generator).numpy(), state

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Choose actions, (n, J) int64 levels, for images (n, H, W, 3) uint8."""
        knowledge, images = self.knowledge_input(observations), torch.as_tensor(observations)
        actions, self._state = self.choose(images, knowledge, self._state, self._episode_start)
        self._episode_start = torch.zeros_like(self._episode_start)
        return actions
