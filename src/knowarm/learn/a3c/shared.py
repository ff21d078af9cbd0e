"""Sizes go in; what all A3C workers read and write comes out."""

from multiprocessing.context import BaseContext
from typing import Any

import torch

from knowarm.learn.shared import SharedTensors


class SharedLearning:
    """Parameters, optimizer statistics and counters of all workers, without a lock.

    Each worker writes only its own counter, so nothing is lost and a worker that dies holds
    nothing the others wait for.

    Args:
        context: start method of the processes it is handed to.
        parameters: P.
        workers: W.
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
        """(P,) float32: the shared policy."""
        self.mean_square = self._tensors["mean_square"]
        """(P,) float32: RMSprop's statistics."""
        self.steps = self._tensors["steps"]
        """(W,) int64: environment steps of each worker."""
        self.updates = self._tensors["updates"]
        """(W,) int64: updates of each worker."""
        self.evaluated = self._tensors["evaluated"]
        """(1,) int64: number of the last interim evaluation that was asked for."""

    def __getstate__(self) -> dict[str, Any]:
        return {"_tensors": self._tensors}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._tensors = state["_tensors"]
        self._open()
