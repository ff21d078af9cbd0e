"""State that A3C's workers share: parameters, RMSprop statistics and counters."""

import torch
from torch import Tensor

from knowarm.learn.parallel.shared_tensors import TensorSpecs


def shared_state_specs(parameters: int, workers: int) -> TensorSpecs:
    """Return the tensors that all workers read and write, without locks.

    Each worker writes only its own counters, so no count is lost, and a worker that dies holds
    nothing that others wait for. With P parameters and W workers: ``values`` (P,) of the policy;
    ``mean_square`` (P,), RMSprop's running mean of squared gradients; ``steps`` and ``updates``
    (W,) of each worker; ``evaluated`` (1,), number of the last interim evaluation that a worker
    requested; ``paused`` (1,), whether the workers wait for the evaluator.
    """
    return {
        "values": ((parameters,), torch.float32),
        "mean_square": ((parameters,), torch.float32),
        "steps": ((workers,), torch.int64),
        "updates": ((workers,), torch.int64),
        "evaluated": ((1,), torch.int64),
        "paused": ((1,), torch.bool),
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
    """Apply one step of RMSprop in place (Tieleman and Hinton 2012); tensors are (P,).

    ``m <- alpha m + (1 - alpha) g^2``, ``x <- x - learning_rate g / (sqrt(m) + eps)``.

    Parameters and statistics may be shared and are written without a lock, as in public
    implementations of A3C: concurrent updates may overwrite parts of each other's step.
    """
    mean_square.mul_(alpha).addcmul_(gradient, gradient, value=1 - alpha)
    values.addcdiv_(gradient, mean_square.sqrt().add_(eps), value=-learning_rate)
