"""State that A3C's workers share: parameters, RMSprop statistics and counters."""

import torch
from torch import Tensor

from knowarm.learn.shared_tensors import TensorSpecs


def shared_state_specs(parameters: int, workers: int) -> TensorSpecs:
    """Return the tensors that all workers read and write, without locks.

    Each worker writes only its own counters, so no count is lost, and a worker that dies holds
    nothing that others wait for.

    Args:
        parameters: number of parameters P.
        workers: number of workers W.

    Returns:
        ``values`` (P,), the parameters of the policy; ``mean_square`` (P,), RMSprop's running mean
        of squared gradients; ``steps`` and ``updates`` (W,) of each worker; ``evaluated`` (1,),
        number of the last interim evaluation that a worker requested.
    """
    return {
        "values": ((parameters,), torch.float32),
        "mean_square": ((parameters,), torch.float32),
        "steps": ((workers,), torch.int64),
        "updates": ((workers,), torch.int64),
        "evaluated": ((1,), torch.int64),
    }


def rmsprop_update(
    values: Tensor,
    mean_square: Tensor,
    gradient: Tensor,
    *,
    learning_rate: float,
    alpha: float,
    eps: float,
) -> None:
    """Apply one step of RMSprop in place (Tieleman and Hinton 2012).

    ``m <- alpha m + (1 - alpha) g^2``, ``x <- x - learning_rate g / (sqrt(m) + eps)``.

    Parameters and statistics may be shared and are written without a lock, as in public
    implementations of A3C: concurrent updates may overwrite parts of each other's step.

    Args:
        values: (P,) parameters, updated.
        mean_square: (P,) running mean of squared gradients, updated.
        gradient: (P,).
        learning_rate: learning rate.
        alpha: decay of the running mean.
        eps: added to the root of the running mean.
    """
    mean_square.mul_(alpha).addcmul_(gradient, gradient, value=1 - alpha)
    values.addcdiv_(gradient, mean_square.sqrt().add_(eps), value=-learning_rate)
