"""Rollouts: buffers for T steps of B environments, inference that writes them, minibatches."""

from dataclasses import dataclass

import torch
from torch import Tensor

from knowarm.learn.losses import next_values
from knowarm.learn.parallel.shared_tensors import TensorSpecs, zeros
from knowarm.policy import Policy, State

WITHOUT_STEPS = {"last_value", "start_h", "start_c"}
"""Fields of a rollout that have no axis of time."""


@dataclass(frozen=True)
class Rollout:
    """Preallocated tensors of a rollout, written in place."""

    patches: Tensor  # (T, B, S, L) uint8: patches of the images; see `Policy.patches`
    knowledge: Tensor  # (T, B, K) float32: knowledge of the episode
    episode_start: Tensor  # (T, B) bool: the image is the first of its episode
    action: Tensor  # (T, B, J) int64
    # (T, B) float32: log-probability of the action, summed over joints [nat]
    log_probability: Tensor
    value: Tensor  # (T, B) float32: value of each observation
    reward: Tensor  # (T, B) float32, unscaled
    terminated: Tensor  # (T, B) bool
    truncated: Tensor  # (T, B) bool
    final_value: Tensor  # (T, B) float32: value of the final observation where truncated, else 0
    last_value: Tensor  # (B,) float32: value of the observation after the last step
    start_h: Tensor  # (B, H) float32: hidden state before the first step
    start_c: Tensor  # (B, H) float32: cell state before the first step

    @classmethod
    def zeros(cls, steps: int, batch: int, policy: Policy) -> "Rollout":
        """Allocate a rollout of T steps of B environments on the CPU."""
        return cls(**zeros(rollout_specs(steps, batch, policy)))

    @property
    def start_state(self) -> State:
        """Recurrent state before the first step."""
        return self.start_h, self.start_c

    @property
    def done(self) -> Tensor:
        """(T, B) bool: the episode ended with this step."""
        return self.terminated | self.truncated

    def following(self, *, bootstrap_at_time_limit: bool = True) -> Tensor:
        """Return the value after each step within its episode, (T, B); see `next_values`.

        A truncated episode continues with the value of its final observation, or with 0.
        """
        ended = self.terminated if bootstrap_at_time_limit else self.done
        return next_values(self.value, self.last_value, self.final_value, ended, self.truncated)

    def first(self, steps: int) -> "Rollout":
        """Return a view of the first steps."""
        tensors = self.tensors().items()
        return Rollout(**{k: v if k in WITHOUT_STEPS else v[:steps] for k, v in tensors})

    def of(self, env_ids: Tensor) -> "Rollout":
        """Return a copy of the environments ``env_ids`` (b,)."""
        tensors = self.tensors().items()
        return Rollout(
            **{k: v.index_select(0 if k in WITHOUT_STEPS else 1, env_ids) for k, v in tensors}
        )

    def tensors(self) -> dict[str, Tensor]:
        """Return all tensors by name."""
        return dict(vars(self))


def rollout_specs(steps: int, batch: int, policy: Policy) -> TensorSpecs:
    """Return shapes and dtypes of the tensors of a rollout of T steps of B environments."""
    table, state = (steps, batch), (batch, policy.hidden_size)
    return {
        "patches": ((*table, *policy.encoder.patch_shape), torch.uint8),
        "knowledge": ((*table, policy.knowledge_width), torch.float32),
        "episode_start": (table, torch.bool),
        "action": ((*table, policy.shape.joints), torch.int64),
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


@torch.no_grad()
def infer_step(
    policy: Policy, rollout: Rollout, t: int, image: Tensor, state: State, envs: slice = slice(None)
) -> tuple[Tensor, State]:
    """Run the policy for step t of the b environments ``envs``.

    ``image`` and ``state`` are those of all environments; ``knowledge`` and ``episode_start`` of
    step t are read from the rollout, and ``patches`` and ``value`` written to it. Returns logits
    (b, J, A) and the next state of these environments.
    """
    patches = rollout.patches[t, envs]
    patches.copy_(policy.patches(image[envs]))
    logits, values, state = policy.step(
        patches,
        rollout.knowledge[t, envs],
        (state[0][envs], state[1][envs]),
        rollout.episode_start[t, envs],
    )
    rollout.value[t, envs] = values
    return logits, state
