"""Sizes go in; preallocated buffers for T steps of B environments come out."""

import torch
from torch import Tensor

from knowarm.learn.returns import next_values
from knowarm.policy.memory import State


class Rollout:
    """What T steps of B environments saw, did and got, one tensor each.

    Args:
        steps: T.
        batch: B.
        image_shape: (H, W, 3).
        joints: J.
    """

    def __init__(self, steps: int, batch: int, image_shape: tuple[int, ...], joints: int) -> None:
        self.image = torch.zeros((steps, batch, *image_shape), dtype=torch.uint8)
        self.facet = torch.zeros((steps, batch), dtype=torch.int64)
        self.episode_start = torch.zeros((steps, batch), dtype=torch.bool)
        self.action = torch.zeros((steps, batch, joints), dtype=torch.int64)
        self.log_probability = torch.zeros(steps, batch)
        self.value = torch.zeros(steps, batch)
        self.reward = torch.zeros(steps, batch)
        self.terminated = torch.zeros((steps, batch), dtype=torch.bool)
        self.truncated = torch.zeros((steps, batch), dtype=torch.bool)
        self.final_value = torch.zeros(steps, batch)
        """Value of the final observation where truncated, else 0."""
        self.last_value = torch.zeros(batch)
        """Value of the observation after the last step."""
        self.start_state: State = (torch.zeros(0), torch.zeros(0))
        """Recurrent state before the first step."""

    @property
    def shape(self) -> tuple[int, int]:
        """(T, B)."""
        steps, batch = self.reward.shape
        return steps, batch

    @property
    def done(self) -> Tensor:
        """(T, B) bool: an episode ended with this step."""
        return self.terminated | self.truncated

    def following(self) -> Tensor:
        """(T, B) value of what follows each step within its episode; see `returns.next_values`."""
        return next_values(
            self.value, self.last_value, self.final_value, self.terminated, self.truncated
        )

    def tensors(self) -> dict[str, Tensor]:
        """All buffers by name, for saving a batch that went wrong."""
        named = {name: value for name, value in vars(self).items() if isinstance(value, Tensor)}
        return {**named, "start_h": self.start_state[0], "start_c": self.start_state[1]}
