"""Losses, gradients and observations go in; a stop that names the guilty one, or a warning."""

import logging
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from knowarm.errors import UserError
from knowarm.learn.losses import LossTerms
from knowarm.learn.rollout import Rollout

log = logging.getLogger("knowarm.learn")


class NotFiniteError(UserError):
    """Training met a NaN or an infinity; ``term`` names where, ``batch`` the saved file."""

    def __init__(self, term: str, step: int, batch: Path | None) -> None:
        where = f"; the batch is saved in {batch}" if batch else ""
        super().__init__(
            f"Training stopped at step {step}: {term} is not finite (NaN or Inf){where}. A smaller "
            "learning rate or gradient limit is the usual remedy; the last checkpoint is whole."
        )
        self.term = term
        self.step = step
        self.batch = batch


class FiniteGuard:
    """Stops training at the first number that is none.

    Args:
        folder: where the guilty batch is saved; None saves nothing.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def check(self, terms: Mapping[str, Tensor], step: int, batch: Mapping[str, Tensor]) -> None:
        """Raise if a term holds a NaN or an infinity.

        Args:
            terms: what is looked at, by the name the message uses.
            step: environment steps so far, for the message.
            batch: tensors that are saved beside the message.

        Raises:
            NotFiniteError: naming the first such term.
        """
        for name, value in terms.items():
            if not bool(torch.isfinite(value).all()):
                raise NotFiniteError(name, step, self._save(step, batch))

    def check_rollout(self, rollout: Rollout, knowledge: Tensor, step: int) -> None:
        """Raise if what was observed, rewarded or valued is not finite."""
        terms = {
            "the knowledge": knowledge,
            "the reward": rollout.reward,
            "the value": rollout.value,
            "the last value": rollout.last_value,
        }
        self.check(terms, step, rollout.tensors())

    def check_update(
        self, policy: nn.Module, loss: LossTerms, norm: Tensor, step: int, rollout: Rollout
    ) -> None:
        """Raise if a loss or a gradient is not finite, naming the term or the parameter.

        The scalars ``loss.total`` and ``norm`` (of the whole gradient) tell whether a closer look
        is needed.
        """
        if bool(torch.isfinite(norm + loss.total.detach())):
            return
        terms = {
            "the policy loss": loss.policy,
            "the value loss": loss.value,
            "the entropy": loss.entropy,
        }
        gradients = {
            f"the gradient of {name}": parameter.grad
            for name, parameter in policy.named_parameters()
            if parameter.grad is not None
        }
        self.check({**terms, **gradients, "the gradient's norm": norm}, step, rollout.tensors())

    def check_updates(
        self, losses: Sequence[LossTerms], norms: Sequence[Tensor], step: int, rollout: Rollout
    ) -> None:
        """Raise if a loss or a gradient of a whole update was not finite, naming the term.

        For a device that was not waited for between the gradient steps; their gradients are gone.
        """
        names = {"the policy loss": "policy", "the value loss": "value", "the entropy": "entropy"}
        terms = {
            name: torch.stack([getattr(loss, field).detach() for loss in losses])
            for name, field in names.items()
        }
        terms["the gradient's norm"] = torch.stack(list(norms))
        self.check(terms, step, rollout.tensors())

    def _save(self, step: int, batch: Mapping[str, Tensor]) -> Path | None:
        if self._folder is None:
            return None
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self._folder / f"not-finite-{step}.safetensors"
        save_file({name: value.detach().cpu().contiguous() for name, value in batch.items()}, path)
        return path


class HealthMonitor:
    """Warns once of a policy that stopped exploring and of values no return can reach.

    Args:
        joints: J.
        levels: A.
        gamma: discount factor; no return exceeds the largest reward over ``1 - gamma``.
    """

    def __init__(self, joints: int, levels: int, gamma: float) -> None:
        self._most_entropy = joints * math.log(levels)
        self._gamma = gamma
        self._largest_reward = 0.0
        self._warned: set[str] = set()

    def watch(self, *, step: int, entropy: float, values: Tensor, rewards: Tensor) -> None:
        """Look at one update: mean entropy [nat], values and (scaled) rewards of the rollout."""
        self._largest_reward = max(self._largest_reward, float(rewards.abs().max()))
        bound = self._largest_reward / (1 - self._gamma) if self._gamma < 1 else math.inf
        largest = float(values.abs().max())
        if entropy < 0.02 * self._most_entropy:
            self._warn(
                "entropy",
                f"Step {step}: the entropy fell to {entropy:.3f} of {self._most_entropy:.2f} nat: "
                "the policy hardly explores any more. A larger ent_coef is the remedy.",
            )
        if largest > bound:
            self._warn(
                "value",
                f"Step {step}: a value of {largest:.3g} is larger than any return can be "
                f"({bound:.3g}): the critic explodes. A smaller learning rate is the remedy.",
            )

    def _warn(self, kind: str, message: str) -> None:
        if kind not in self._warned:
            self._warned.add(kind)
            log.warning(message)
