"""Minibatch gradient: PPO's loss and its gradient over some environments of a rollout."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from knowarm.learn.algorithms import PPOConfig
from knowarm.learn.losses import PPOLossTerms, ppo_loss
from knowarm.learn.parallel.shared_tensors import TensorSpecs
from knowarm.learn.rollout import Rollout, rollout_specs
from knowarm.policy import Policy
from knowarm.policy.encoder import orthogonal
from knowarm.seeding import torch_generator


@dataclass(frozen=True)
class Targets:
    """Targets of PPO's loss for one rollout."""

    advantage: Tensor
    """(T, B) float32."""
    returns: Tensor
    """(T, B) float32."""
    auxiliary: Tensor | None = None
    """(T, B, K) float32: what the auxiliary head predicts."""


class TrainingNetwork(nn.Module):
    """The policy, and in training only a head that predicts K auxiliary targets (0: no head)."""

    def __init__(self, policy: Policy, auxiliary_targets: int, seed: int = 0) -> None:
        super().__init__()
        self.policy = policy
        self.auxiliary_targets = auxiliary_targets
        self.head: nn.Linear | None = None
        if auxiliary_targets:
            self.head = nn.Linear(policy.fc.out_features, auxiliary_targets)
            orthogonal(self.head, 1.0, torch_generator(seed, "weights", 2))
            self.head.to(policy.fc.weight.device)

    def parameters_by_name(self) -> dict[str, nn.Parameter]:
        """Return the parameters by name, those of the head after ``auxiliary``."""
        head = self.head.named_parameters() if self.head else ()
        named = {f"auxiliary.{name}": parameter for name, parameter in head}
        return {**dict(self.policy.named_parameters()), **named}


def buffer_specs(network: TrainingNetwork, config: PPOConfig) -> TensorSpecs:
    """Return shapes and dtypes of the tensors of a rollout and its targets."""
    steps, batch = config.rollout_steps, config.num_envs
    shapes: dict[str, tuple[int, ...]] = {"advantage": (steps, batch), "returns": (steps, batch)}
    if network.auxiliary_targets:
        shapes["auxiliary"] = (steps, batch, network.auxiliary_targets)
    targets = {name: (shape, torch.float32) for name, shape in shapes.items()}
    return {**rollout_specs(steps, batch, network.policy), **targets}


def buffers(tensors: Mapping[str, Tensor]) -> tuple[Rollout, Targets]:
    """Build rollout and targets from tensors by name; others are ignored."""
    rollout, targets = (
        {name: tensors[name] for name in kind.__annotations__ if name in tensors}
        for kind in (Rollout, Targets)
    )
    return Rollout(**rollout), Targets(**targets)


def add_gradient(
    network: TrainingNetwork,
    config: PPOConfig,
    rollout: Rollout,
    targets: Targets,
    env_ids: Tensor,
    weight: float = 1.0,
) -> PPOLossTerms:
    """Add the gradient of the loss over the environments ``env_ids`` (b,) to those of the network.

    The loss has a factor ``weight``: b over the number of environments in the whole minibatch, so
    that the returned terms of a minibatch's parts add up to its own.
    """
    h, c = rollout.start_state
    logits, values, _, features = network.policy.unroll_with_features(
        rollout.patches.index_select(1, env_ids),
        rollout.facet[:, env_ids],
        (h[env_ids], c[env_ids]),
        rollout.episode_start[:, env_ids],
    )
    auxiliary = None
    if network.head is not None and targets.auxiliary is not None:
        predicted = network.head(features.float())
        error = predicted - targets.auxiliary[:, env_ids].flatten(0, 1)
        auxiliary = error.square().mean()
    terms = ppo_loss(
        logits,
        values,
        rollout.action[:, env_ids],
        rollout.log_probability[:, env_ids],
        targets.advantage[:, env_ids],
        targets.returns[:, env_ids],
        clip_range=config.clip_range,
        vf_coef=config.vf_coef,
        ent_coef=config.ent_coef,
        auxiliary=auxiliary,
        auxiliary_coef=config.auxiliary_coef,
    )
    (terms.total * weight).backward()
    return terms.scaled(weight)
