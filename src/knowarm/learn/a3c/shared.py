"""Sizes go in; memory that every process sees comes out."""

import ctypes
from multiprocessing.context import BaseContext
from typing import Any

import torch
from torch import Tensor


class SharedLearning:
    """Parameters, optimizer statistics and counters of all workers, without a lock.

    Each worker writes only its own counter, so nothing is lost and a worker that dies holds
    nothing the others wait for. The memory has no name in the file system: it is gone when the
    last process is.

    Args:
        context: start method of the processes it is handed to.
        parameters: P.
        workers: W.
    """

    def __init__(self, context: BaseContext, parameters: int, workers: int) -> None:
        self._buffers: dict[str, tuple[Any, torch.dtype]] = {
            "values": (_array(ctypes.c_float, parameters, context), torch.float32),
            "mean_square": (_array(ctypes.c_float, parameters, context), torch.float32),
            "steps": (_array(ctypes.c_int64, workers, context), torch.int64),
            "updates": (_array(ctypes.c_int64, workers, context), torch.int64),
            "evaluated": (_array(ctypes.c_int64, 1, context), torch.int64),
        }
        self._open()

    def _open(self) -> None:
        def tensor(name: str) -> Tensor:
            buffer, kind = self._buffers[name]
            return torch.frombuffer(buffer, dtype=kind)

        self.values = tensor("values")
        """(P,) float32: the shared policy."""
        self.mean_square = tensor("mean_square")
        """(P,) float32: RMSprop's statistics."""
        self.steps = tensor("steps")
        """(W,) int64: environment steps of each worker."""
        self.updates = tensor("updates")
        """(W,) int64: updates of each worker."""
        self.evaluated = tensor("evaluated")
        """(1,) int64: number of the last interim evaluation that was asked for."""

    def __getstate__(self) -> dict[str, Any]:
        return {"_buffers": self._buffers}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._buffers = state["_buffers"]
        self._open()


def _array(kind: type, size: int, context: BaseContext) -> Any:
    return context.RawArray(kind, size)
