"""Network of a training: the policy with an auxiliary head, and the type of its losses."""

from collections.abc import Callable, Mapping

from torch import Tensor, nn

from knowarm.learn.losses import Terms
from knowarm.learn.rollout import Rollout
from knowarm.policy import Policy
from knowarm.policy.encoder import orthogonal
from knowarm.seeding import torch_generator


class TrainingNetwork(nn.Module):
    """The policy, and in training only a head that predicts K auxiliary targets (0: no head)."""

    def __init__(self, policy: Policy, auxiliary_targets: int = 0, seed: int = 0) -> None:
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

    def forward(self, batch: Rollout) -> tuple[Tensor, Tensor, Tensor]:
        """Return logits (T, b, J, A), values (T, b) and image features (T * b, F) of a rollout."""
        logits, values, _, features = self.policy.unroll_with_features(
            batch.patches, batch.knowledge, batch.start_state, batch.episode_start
        )
        return logits, values, features

    def add_auxiliary(
        self, terms: Terms, features: Tensor, targets: "Targets", coefficient: float
    ) -> Terms:
        """Add the mean squared error of the head, if there is one, to the terms of a loss."""
        if self.head is None:
            return terms
        error = self.head(features.float()) - targets["auxiliary"].flatten(0, 1)
        auxiliary = error.square().mean()
        total = terms["total"] + coefficient * auxiliary
        return {**terms, "total": total, "auxiliary_loss": auxiliary}


Targets = Mapping[str, Tensor]
"""What a loss compares a rollout with, by name, each (T, B, ...)."""
Loss = Callable[[TrainingNetwork, Rollout, Targets], Terms]
"""Computes the terms of an algorithm's loss over a minibatch; picklable."""
