"""Images and recurrent states go in; logits, values and the next states come out."""

from typing import Protocol

import torch
from torch import Tensor

from knowarm.learn.rollout import Rollout
from knowarm.policy import Policy
from knowarm.policy.memory import State


class Player(Protocol):
    """What chooses the actions of a rollout."""

    policy: Policy

    def play(self, rollout: Rollout, t: int, image: Tensor, state: State) -> tuple[Tensor, State]:
        """Take step t of all environments.

        Args:
            rollout: its ``facet`` and ``episode_start`` of step t are there; ``patches`` and
                ``value`` of step t are written.
            t: the step.
            image: (B, H, W, 3) uint8.
            state: the state after the step before.

        Returns:
            logits (B, J, A) and the next state.
        """
        ...


class SoloPlayer:
    """A policy that plays alone.

    Args:
        policy: the policy.
        table: (F, K) float32 knowledge, one row a facet.
    """

    def __init__(self, policy: Policy, table: Tensor) -> None:
        self.policy = policy
        self.table = table

    def play(self, rollout: Rollout, t: int, image: Tensor, state: State) -> tuple[Tensor, State]:
        """As `Player.play`."""
        return play_rows(self.policy, self.table, rollout, t, image, state, slice(None))


@torch.no_grad()
def play_rows(
    policy: Policy,
    table: Tensor,
    rollout: Rollout,
    t: int,
    image: Tensor,
    state: State,
    rows: slice,
) -> tuple[Tensor, State]:
    """Take step t of the environments ``rows``; see `Player.play`."""
    patches = rollout.patches[t, rows]
    patches.copy_(policy.patches(image[rows]))
    logits, values, state = policy.step(
        patches,
        table[rollout.facet[t, rows]],
        (state[0][rows], state[1][rows]),
        rollout.episode_start[t, rows],
    )
    rollout.value[t, rows] = values
    return logits, state
