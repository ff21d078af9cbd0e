"""Names, shapes and types go in; tensors in memory that every process sees come out."""

import ctypes
import math
from collections.abc import Mapping
from multiprocessing.context import BaseContext
from typing import Any

import torch
from torch import Tensor

Shapes = Mapping[str, tuple[tuple[int, ...], torch.dtype]]
"""Shape and type of each tensor."""


class SharedTensors:
    """Tensors by name, zero at first, in memory shared with every process they are handed to.

    There is no lock. The memory has no name in the file system: it is gone when the last process
    is.

    Args:
        context: start method of the processes.
        shapes: what to make.
    """

    def __init__(self, context: BaseContext, shapes: Shapes) -> None:
        self._buffers: dict[str, tuple[Any, tuple[int, ...], torch.dtype]] = {
            name: (context.RawArray(ctypes.c_uint8, math.prod(shape) * kind.itemsize), shape, kind)
            for name, (shape, kind) in shapes.items()
        }
        self._open()

    def __getitem__(self, name: str) -> Tensor:
        """Return a tensor; writing it writes the shared memory."""
        return self._tensors[name]

    def of(self, shapes: Shapes) -> dict[str, Tensor]:
        """Return the tensors of these names."""
        return {name: self._tensors[name] for name in shapes}

    def _open(self) -> None:
        self._tensors = {
            name: torch.frombuffer(buffer, dtype=kind).view(shape)
            for name, (buffer, shape, kind) in self._buffers.items()
        }

    def __getstate__(self) -> dict[str, Any]:
        return {"_buffers": self._buffers}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._buffers = state["_buffers"]
        self._open()
