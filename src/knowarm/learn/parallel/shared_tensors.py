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
    """

    def __init__(self, context: BaseContext, specs: TensorSpecs) -> None:
        buffers = {}
        for name, (shape, dtype) in specs.items():
            size = math.prod(shape) * dtype.itemsize
            buffers[name] = (context.RawArray(ctypes.c_uint8, size), shape, dtype)
        self.__setstate__(buffers)

    def __getitem__(self, name: str) -> Tensor:
        """Return a tensor."""
        return self.tensors[name]

    def __getstate__(self) -> dict[str, Any]:
        return self._buffers

    def __setstate__(self, buffers: dict[str, Any]) -> None:
        self._buffers = buffers
        self.tensors = {
            name: torch.frombuffer(buffer, dtype=dtype).view(shape)
            for name, (buffer, shape, dtype) in buffers.items()
        }
