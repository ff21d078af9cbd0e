"""Guards: stop training at non-finite values, warn of collapsed entropy and diverging values."""

import logging
import math
from pathlib import Path

import torch
from safetensors.numpy import save_file
from torch import Tensor, nn

from knowarm.errors import UserError
from knowarm.learn.checkpoint import Tensors, to_arrays
from knowarm.learn.losses import Terms
from knowarm.learn.rollout import Rollout

log = logging.getLogger("knowarm.learn")


class NotFiniteError(UserError):
    """Training produced a NaN or an infinity; the message names term, step and saved rollout."""


class FiniteGuard:
    """Stops training at the first non-finite value; ``folder`` receives the rollout with it."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def check(self, terms: Tensors, step: int, batch: Tensors) -> None:
        """Raise a `NotFiniteError` naming the first term that is not finite; save ``batch``."""
        for name, value in terms.items():
            if torch.isfinite(value).all():
                continue
            where = ""
            if self._folder is not None:
                self._folder.mkdir(parents=True, exist_ok=True)
                path = self._folder / f"not-finite-{step}.safetensors"
                save_file(to_arrays(batch), path)
                where = f"; the rollout is saved in {path}"
            raise NotFiniteError(
                f"Training stopped at step {step}: {name} is not finite (NaN or Inf){where}. A "
                "smaller learning_rate or max_grad_norm usually helps; the last checkpoint is "
                "intact."
            )

    def check_rollout(self, rollout: Rollout, step: int) -> None:
        """Raise an error if knowledge, rewards or values of a rollout are not finite."""
        terms = {
            "the knowledge": rollout.knowledge,
            "the reward": rollout.reward,
            "the value": rollout.value,
            "the last value": rollout.last_value,
        }
        self.check(terms, step, rollout.tensors())

    def check_update(
        self,
        policy: nn.Module,
        loss: Terms,
        norm: Tensor,
        step: int,
        rollout: Rollout,
    ) -> None:
        """Raise an error naming the loss term or parameter if a gradient step is not finite.

        Single terms are examined only if the total loss or the gradient's ``norm`` is not finite.
        """
        if torch.isfinite(norm + loss["total"].detach()).all():
            return
        terms = {f"the {name.replace('_', ' ')}": term for name, term in loss.items()}
        del terms["the total"]
        for name, parameter in policy.named_parameters():
            if parameter.grad is not None:
                terms[f"the gradient of {name}"] = parameter.grad
        terms["the gradient's norm"] = norm
        self.check(terms, step, rollout.tensors())


class HealthMonitor:
    """Warns once of a collapsed entropy, and once of values far beyond every return.

    No return exceeds the largest reward divided by ``1 - gamma``. Early in training the largest
    reward is not known yet, so that values may exceed this bound up to tenfold.
    """

    def __init__(self, joints: int, levels: int, gamma: float) -> None:
        self._max_entropy = joints * math.log(levels)
        self._gamma = gamma
        self._largest_reward = 0.0
        self._warned: set[str] = set()

    def watch(
        self,
        *,
        step: int,
        entropy: float,
        values: Tensor,
        rewards: Tensor,
    ) -> None:
        """Check one update: mean entropy [nat], values and (scaled) rewards of the rollout."""
        self._largest_reward = max(self._largest_reward, float(rewards.abs().max()))
        largest = float(values.abs().max())
        bound = math.inf
        if self._gamma < 1:
            bound = self._largest_reward / (1 - self._gamma)
        if entropy < 0.02 * self._max_entropy:
            self._warn_once(
                "entropy",
                step,
                f"the entropy fell to {entropy:.3f} of {self._max_entropy:.2f} nat, so the policy "
                "hardly explores. Increase ent_coef.",
            )
        if 0 < 10 * bound < largest:
            self._warn_once(
                "values",
                step,
                f"a value of {largest:.3g} is more than ten times the largest return that the "
                f"rewards so far allow ({bound:.3g}). If it grows, the critic diverges: decrease "
                "learning_rate.",
            )

    def _warn_once(self, subject: str, step: int, message: str) -> None:
        if subject not in self._warned:
            self._warned.add(subject)
            log.warning("Step %d: %s", step, message)
