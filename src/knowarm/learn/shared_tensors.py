"""Tensors in memory shared between processes."""

import ctypes
import math
from collections.abc import Mapping
from multiprocessing.context import BaseContext
from typing import Any

import torch
from torch import Tensor

TensorSpecs = Mapping[str, tuple[tuple[int, ...], torch.dtype]]
"""Shape and dtype of each tensor by name."""


def zeros(specs: TensorSpecs, device: torch.device | None = None) -> dict[str, Tensor]:
    """Allocate tensors of zeros by name, not shared; without a device, on the CPU."""
    return {
        name: torch.zeros(shape, dtype=dtype, device=device)
        for name, (shape, dtype) in specs.items()
    }


class SharedTensors:
    """Tensors by name, initially zero, in memory shared with every process that receives them.

    There is no lock. The memory has no name in the file system and is released with the last
    process that uses it.

    Args:
        context: start method of the processes.
        specs: the tensors.
    """

    def __init__(self, context: BaseContext, specs: TensorSpecs) -> None:
        self._buffers: dict[str, tuple[Any, tuple[int, ...], torch.dtype]] = {
            name: (
                context.RawArray(ctypes.c_uint8, math.prod(shape) * dtype.itemsize),
                shape,
                dtype,
            )
            for name, (shape, dtype) in specs.items()
        }
        self._open()

    def __getitem__(self, name: str) -> Tensor:
        """Return a tensor; writing to it writes the shared memory."""
        return self._tensors[name]

    def select(self, specs: TensorSpecs) -> dict[str, Tensor]:
        """Return the tensors with the names of ``specs``."""
        return {name: self._tensors[name] for name in specs}

    def _open(self) -> None:
        self._tensors = {
            name: torch.frombuffer(buffer, dtype=dtype).view(shape)
            for name, (buffer, shape, dtype) in self._buffers.items()
        }

    def __getstate__(self) -> dict[str, Any]:
        return {"_buffers": self._buffers}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._buffers = state["_buffers"]
        self._open()
