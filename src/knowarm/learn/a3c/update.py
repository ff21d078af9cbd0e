"""What both schedules of A3C compute: the loss of a rollout, and steps of RMSprop."""

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from knowarm.compiling import njit
from knowarm.learn.algorithms import A3CConfig
from knowarm.learn.losses import Terms, a3c_loss, advantages, n_step_returns
from knowarm.learn.rollout import Rollout
from knowarm.policy import Policy

RMSPROP_ALPHA = 0.99
"""Decay of RMSprop's running mean of squared gradients (paper section 4.2)."""

Floats = NDArray[np.float32]

_BLOCK = 4096
"""Parameters that all updates change in turn before the next ones, so that they stay in cache."""


def rollout_loss(
    policy: Policy,
    config: A3CConfig,
    rollout: Rollout,
    *,
    encoded: Tensor | None = None,
    weights: Tensor | None = None,
) -> Terms:
    """Compute A3C's loss, with gradient, at the parameters that collected the rollout.

    Args:
        policy: the policy.
        config: the algorithm's configuration.
        rollout: T steps of B environments.
        encoded: (T, B, width), what the encoder makes of the rollout's patches, if known.
        weights: (T, B), of the steps in the sums of the loss; None: all alike.
    """
    reward = rollout.reward * config.reward_scale
    following = rollout.following(
        bootstrap_at_time_limit=config.bootstrap_at_time_limit
    )
    advantage = advantages(
        reward, rollout.value, following, rollout.done, config.gamma, config.gae_lambda
    )
    returns = n_step_returns(reward, following, rollout.done, config.gamma)
    logits, values, _ = policy.unroll(
        rollout.patches if encoded is None else encoded,
        rollout.knowledge,
        rollout.start_state,
        rollout.episode_start,
    )
    return a3c_loss(
        logits,
        values,
        rollout.action,
        advantage,
        returns,
        vf_coef=config.vf_coef,
        ent_coef=config.ent_coef,
        weights=weights,
    )


def rmsprop_update(
    values: Tensor,
    mean_square: Tensor,
    gradient: Tensor,
    *,
    learning_rate: float,
    eps: float,
) -> None:
    """Apply one step of RMSprop in place (Tieleman and Hinton 2012); tensors are (P,).

    ``m <- .99 m + .01 g^2``, ``x <- x - learning_rate g / (sqrt(m) + eps)``.

    Parameters and statistics may be shared and are written without a lock, as in public
    implementations of A3C: concurrent updates may overwrite parts of each other's step.
    """
    mean_square.mul_(RMSPROP_ALPHA).addcmul_(
        gradient, gradient, value=1 - RMSPROP_ALPHA
    )
    values.addcdiv_(gradient, mean_square.sqrt().add_(eps), value=-learning_rate)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def rmsprop_updates(
    values: Floats,
    mean_square: Floats,
    gradients: Floats,
    order: NDArray[np.int64],
    factors: Floats,
    learning_rates: Floats,
    eps: np.float32,
) -> None:
    """Apply W steps of RMSprop one after another, in place; see `rmsprop_update`.

    ``values`` and ``mean_square`` are (P,), and ``gradients`` (W, P) are applied in an ``order``
    (W,), each multiplied by its own of the ``factors`` and with its own learning rate.
    """
    kept = np.float32(RMSPROP_ALPHA)
    added = np.float32(1 - RMSPROP_ALPHA)
    for begin in range(0, len(values), _BLOCK):
        block = slice(begin, begin + _BLOCK)
        x = values[block]
        m = mean_square[block]
        for k in order:
            g = gradients[k, block]
            factor = factors[k]
            rate = learning_rates[k]
            for p in range(len(x)):
                scaled = g[p] * factor
                m[p] = kept * m[p] + added * scaled * scaled
                x[p] -= rate * scaled / (np.sqrt(m[p]) + eps)
