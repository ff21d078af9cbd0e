"""Sizes go in; preallocated buffers for T steps of B environments come out."""

from dataclasses import dataclass

import torch
from torch import Tensor

from knowarm.learn.returns import next_values
from knowarm.learn.shared import Shapes
from knowarm.policy import Policy
from knowarm.policy.memory import State


@dataclass(frozen=True)
class Rollout:
    """What T steps of B environments saw, did and got; the tensors are written in place."""

    patches: Tensor
    """(T, B, S, L) uint8: what the policy looks at of the images; see `Policy.patches`."""
    facet: Tensor
    """(T, B) int64: row of the knowledge table."""
    episode_start: Tensor
    """(T, B) bool: the image is the first of its episode."""
    action: Tensor
    """(T, B, J) int64."""
    log_probability: Tensor
    """(T, B) float32, of the whole action [nat]."""
    value: Tensor
    """(T, B) float32."""
    reward: Tensor
    """(T, B) float32, as the environment gives it."""
    terminated: Tensor
    """(T, B) bool."""
    truncated: Tensor
    """(T, B) bool."""
    final_value: Tensor
    """(T, B) float32: value of the final observation where truncated, else 0."""
    last_value: Tensor
    """(B,) float32: value of the observation after the last step."""
    start_h: Tensor
    """(B, H) float32: hidden state before the first step."""
    start_c: Tensor
    """(B, H) float32: cell before the first step."""

    @classmethod
    def zeros(cls, shapes: Shapes, device: torch.device | None = None) -> "Rollout":
        """Make the tensors of `rollout_shapes`, on a device or in the host's memory."""
        return cls(
            **{
                name: torch.zeros(shape, dtype=kind, device=device)
                for name, (shape, kind) in shapes.items()
            }
        )

    @property
    def shape(self) -> tuple[int, int]:
        """(T, B)."""
        steps, batch = self.reward.shape
        return steps, batch

    @property
    def start_state(self) -> State:
        """Recurrent state before the first step."""
        return self.start_h, self.start_c

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
        return dict(vars(self))


def rollout_shapes(steps: int, batch: int, policy: Policy) -> Shapes:
    """Shapes and types of a rollout's tensors.

    Args:
        steps: T.
        batch: B.
        policy: gives patches, joints and state their sizes.
    """
    table, state = (steps, batch), (batch, policy.config.hidden_size)
    return {
        "patches": ((*table, *policy.encoder.patch_shape), torch.uint8),
        "facet": (table, torch.int64),
        "episode_start": (table, torch.bool),
        "action": ((*table, policy.config.joints), torch.int64),
        "log_probability": (table, torch.float32),
        "value": (table, torch.float32),
        "reward": (table, torch.float32),
        "terminated": (table, torch.bool),
        "truncated": (table, torch.bool),
        "final_value": (table, torch.float32),
        "last_value": ((batch,), torch.float32),
        "start_h": (state, torch.float32),
        "start_c": (state, torch.float32),
    }
