"""Policy agent: plays batches of episodes with a policy."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from knowarm.policy.policy import Policy, sample


class NamedEpisodes(Protocol):
    """Members of a batch of episodes that `PolicyAgent` reads."""

    @property
    def rows(self) -> np.ndarray:
        """Row of the knowledge table of each episode, (n,) int64."""


class PolicyAgent:
    """Chooses actions with a policy; keeps its recurrent state, and its knowledge in an episode.

    Call `reset` after every reset of the environments, then `act` once per step.

    Args:
        policy: the policy, with its knowledge table; it is not changed.
        greedy: choose the most probable action instead of sampling.
        generator: samples the actions; required unless ``greedy``.

    Attributes:
        rows: row of the knowledge table of each episode, (n,) int64.
        knowledge: what the policy receives in the episode, `recognize` in its first image.
    """

    def __init__(
        self, policy: Policy, *, greedy: bool, generator: torch.Generator | None = None
    ) -> None:
        if not greedy and generator is None:
            raise ValueError("PolicyAgent(greedy=False) needs a generator to sample actions.")
        self.policy = policy
        self.greedy = greedy
        self.generator = generator

    def reset(self, batch: NamedEpisodes) -> None:
        """Forget everything: n episodes start."""
        self.rows = torch.as_tensor(batch.rows)
        self._state = self.policy.initial_state(len(self.rows))
        self._episode_start = torch.ones(len(self.rows), dtype=torch.bool)
        self.knowledge: Tensor | None = None

    def recognize(self, images: Tensor) -> Tensor:
        """Return row (n,) int64, or knowledge (n, K) float32, of episodes that start."""
        return self.rows

    @torch.inference_mode()
    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Choose actions, (n, J) int64 levels; ``observations["image"]`` is (n, H, W, 3) uint8."""
        images = torch.as_tensor(observations["image"])
        if self.knowledge is None:
            self.knowledge = self.recognize(images)
        logits, _, self._state = self.policy.step(
            images, self.knowledge, self._state, self._episode_start
        )
        self._episode_start = torch.zeros_like(self._episode_start)
        if self.greedy:
            return logits.argmax(-1).numpy()
        assert self.generator is not None
        return sample(logits, self.generator).numpy()
