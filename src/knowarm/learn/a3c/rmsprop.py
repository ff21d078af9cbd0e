"""Shared parameters, their statistics and a gradient go in; the next parameters come out."""

from torch import Tensor


def rmsprop_update(
    values: Tensor,
    mean_square: Tensor,
    gradient: Tensor,
    *,
    learning_rate: float,
    decay: float,
    epsilon: float,
) -> None:
    """One step of RMSprop in place (Tieleman and Hinton 2012).

    ``m <- decay m + (1 - decay) g^2``, ``x <- x - learning_rate g / (sqrt(m) + epsilon)``.

    Values and statistics may lie in shared memory and are written without a lock, as in the
    public lineage of A3C: workers that write at the same time may lose a part of one another's
    step, never more.

    Args:
        values: (P,) parameters, changed.
        mean_square: (P,) running mean of squared gradients, changed.
        gradient: (P,).
        learning_rate: step size.
        decay: share of the old mean that stays.
        epsilon: keeps the division finite.
    """
    mean_square.mul_(decay).addcmul_(gradient, gradient, value=1 - decay)
    values.addcdiv_(gradient, mean_square.sqrt().add_(epsilon), value=-learning_rate)
