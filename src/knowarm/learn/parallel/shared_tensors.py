"""Tensors in memory shared between processes, and parameters as one flat tensor."""

import ctypes
import math
from collections.abc import Mapping
from multiprocessing.context import BaseContext
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.utils import parameters_to_vector

from knowarm.learn.checkpoint import Arrays, Tensors, to_arrays

TensorSpecs = Mapping[str, tuple[tuple[int, ...], torch.dtype]]
"""Shape and dtype of each tensor by name."""


def zeros(specs: TensorSpecs, device: torch.device | None = None) -> Tensors:
    """Allocate tensors of zeros by name, not shared; without a device, on the CPU."""
    tensors = {}
    for name, (shape, dtype) in specs.items():
        tensors[name] = torch.zeros(shape, dtype=dtype, device=device)
    return tensors


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

    def copy(self, name: str) -> np.ndarray:
        """Copy a tensor into an array of this process."""
        return self.tensors[name].numpy().copy()

    def __getstate__(self) -> dict[str, Any]:
        return self._buffers

    def __setstate__(self, buffers: dict[str, Any]) -> None:
        self._buffers = buffers
        self.tensors: Tensors = {}
        for name, (buffer, shape, dtype) in buffers.items():
            if len(buffer):
                self.tensors[name] = torch.frombuffer(buffer, dtype=dtype).view(shape)
            else:  # PyTorch makes no tensor from an empty buffer
                self.tensors[name] = torch.zeros(shape, dtype=dtype)


class FlatParameters:
    """The parameters of a module as one vector, in the order of ``named_parameters``.

    The module's parameters become views: writing the vector changes the module, and a backward
    pass fills the gradient vector.

    Attributes:
        values: (P,) float32, as given, whose content the module takes over, or new memory.
        gradient: (P,) float32, as given or new memory.
    """

    def __init__(
        self,
        module: nn.Module,
        values: Tensor | None = None,
        gradient: Tensor | None = None,
    ) -> None:
        if values is None:
            values = parameters_to_vector(module.parameters()).detach()
        if gradient is None:
            gradient = torch.zeros_like(values)
        self.values = values
        self.gradient = gradient
        views = parameter_views(module, values)
        gradients = parameter_views(module, gradient)
        for name, parameter in module.named_parameters():
            parameter.data = views[name]
            parameter.grad = gradients[name]


def clip_gradient(gradient: Tensor, max_norm: float) -> Tensor:
    """Scale a gradient (P,) down to ``max_norm`` if it is longer; return its norm before."""
    norm = torch.linalg.vector_norm(gradient)
    if norm > max_norm:
        gradient.mul_(max_norm / norm)
    return norm


def parameter_views(module: nn.Module, vector: Tensor) -> Tensors:
    """Split a vector (P,) into views with the names and shapes of a module's parameters."""
    views = {}
    start = 0
    for name, parameter in module.named_parameters():
        end = start + parameter.numel()
        views[name] = vector[start:end].view_as(parameter)
        start = end
    return views


def flatten_parameters(module: nn.Module) -> np.ndarray:
    """Copy all parameters of a module into one vector (P,) float32 on the host."""
    return parameters_to_vector(module.parameters()).detach().cpu().numpy()


def unflatten_parameters(module: nn.Module, values: np.ndarray) -> Arrays:
    """Split a vector (P,) into copies with the names and shapes of a module's parameters."""
    return to_arrays(parameter_views(module, torch.from_numpy(values)))
