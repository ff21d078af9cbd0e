"""Policy agent: plays batches of episodes with a policy."""

import copy
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, Self, cast

import numpy as np
import torch
from torch import Tensor

from knowarm.errors import UserError
from knowarm.policy.policy import Policy, sample


class NamedEpisodes(Protocol):
    """Members of a batch of episodes that `PolicyAgent` reads."""

    @property
    def env(self) -> Any:
        """Their task, with which a recognition must fit."""

    @property
    def rows(self) -> np.ndarray:
        """Row of the knowledge table of each episode, (n,) int64."""


class PolicyAgent:
    """Chooses actions with a policy; keeps its recurrent state, and its knowledge in an episode.

    Call `reset` after every reset of the environments, then `act` once per step.

    Args:
        policy: the policy; it is not changed.
        table: (rows, K) float32, what it knows in the episodes of each row; None without knowledge.
        recognition: in place of a table, a `FrameRecognition`, which reads the first image.
        greedy: choose the most probable action instead of sampling.
        generator: samples the actions; required unless ``greedy``.

    Attributes:
        rows: row of the table of each episode, (n,) int64.
        knowledge: what the policy receives in the episode, (n, K) float32: that of `recognize` in
            its first image.
        notes: what it reports of the episodes beside its actions, by name, (n, ...) each.
    """

    notes: dict[str, np.ndarray]

    def __init__(
        self,
        policy: Policy,
        table: np.ndarray | None = None,
        *,
        recognition: Any = None,
        greedy: bool,
        generator: torch.Generator | None = None,
    ) -> None:
        if not greedy and generator is None:
            raise ValueError(
                "PolicyAgent(greedy=False) needs a generator to sample actions."
            )
        self.policy = policy
        self.recognition = recognition
        self.notes = {}
        self.table: Tensor | None = None
        if table is not None:
            self.table = torch.as_tensor(table, dtype=torch.float32)
        self.greedy = greedy
        self.generator = generator

    def reset(self, batch: NamedEpisodes) -> None:
        """Forget everything: n episodes start; the next image is the first of each."""
        if self.recognition is not None:
            self.recognition.check_fits(batch.env)
        self.notes = {}
        self.rows = torch.as_tensor(batch.rows)
        self._state = self.policy.initial_state(len(self.rows))
        self._episode_start = torch.ones(len(self.rows), dtype=torch.bool)
        self.knowledge: Tensor | None = None

    @property
    def depends_on_rows(self) -> bool:
        """Whether the knowledge of episodes of different rows differs."""
        if self.recognition is not None:
            return bool(self.recognition.depends_on_rows)
        return self.table is not None and bool((self.table != self.table[:1]).any())

    @property
    def told(self) -> Tensor:
        """What it knows in the episodes of each row, (rows, D): numbers, or what it looks for."""
        if self.recognition is not None:
            return cast(Tensor, self.recognition.knowledge)
        assert self.table is not None
        return self.table

    def telling(self, rows: Sequence[Tensor]) -> Self:
        """Return the same agent with other rows, (D,) each."""
        agent = copy.copy(self)
        if self.recognition is None:
            agent.table = torch.stack(list(rows))
        else:
            agent.recognition = copy.deepcopy(self.recognition)
            agent.recognition.knowledge = torch.stack(list(rows))
        return agent

    def recognize(self, images: Tensor) -> Tensor:
        """Return the knowledge of episodes that start with images (n, H, W, 3), (n, K) float32."""
        if self.recognition is not None:
            return cast(Tensor, self.recognition(images, self.rows))
        if self.table is None:
            return torch.zeros(len(self.rows), 0)
        return self.table[self.rows]

    @torch.inference_mode()
    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Choose actions, (n, J) int64 levels; ``observations["image"]`` is (n, H, W, 3) uint8.

        Raises:
            UserError: images of another size or type.
        """
        image = np.asarray(observations["image"])
        size = self.policy.shape.image_size
        if image.shape != (len(self.rows), size, size, 3) or image.dtype != np.uint8:
            raise UserError(
                f"The image must be ({size}, {size}, 3) uint8, or n of them, got {image.shape} "
                f"{image.dtype}: resize it, and keep values of 0 to 255."
            )
        # A copy, as the array may be a backward view or read-only.
        images = torch.from_numpy(image.copy())
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
