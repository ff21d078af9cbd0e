"""Shared state of the A3C workers: parameters, RMSprop statistics and counters."""

from multiprocessing.context import BaseContext
from typing import Any

import torch
from torch import Tensor

from knowarm.learn.shared_tensors import SharedTensors


class SharedState:
    """Parameters, optimizer statistics and counters of all workers, without locks.

    Each worker writes only its own counters, so no count is lost, and a worker that dies holds
    nothing that others wait for.

    Args:
        context: start method of the worker processes.
        parameters: number of parameters P.
        workers: number of workers W.

    Attributes:
        values: (P,) float32, parameters of the policy.
        mean_square: (P,) float32, RMSprop's running mean of squared gradients.
        steps: (W,) int64, environment steps of each worker.
        updates: (W,) int64, updates of each worker.
        evaluated: (1,) int64, number of the last interim evaluation that a worker requested.
    """

    def __init__(self, context: BaseContext, parameters: int, workers: int) -> None:
        self._tensors = SharedTensors(
            context,
            {
                "values": ((parameters,), torch.float32),
                "mean_square": ((parameters,), torch.float32),
                "steps": ((workers,), torch.int64),
                "updates": ((workers,), torch.int64),
                "evaluated": ((1,), torch.int64),
            },
        )
        self._open()

    def _open(self) -> None:
        self.values = self._tensors["values"]
        self.mean_square = self._tensors["mean_square"]
        self.steps = self._tensors["steps"]
        self.updates = self._tensors["updates"]
        self.evaluated = self._tensors["evaluated"]

    def __getstate__(self) -> dict[str, Any]:
        return {"_tensors": self._tensors}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._tensors = state["_tensors"]
        self._open()


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
