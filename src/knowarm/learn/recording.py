"""A function of device tensors goes in; the same kernels, launched as one, come out."""

from collections.abc import Callable

import torch
from torch import Tensor

WARM_UPS = 3
"""Calls before recording: the first ones choose algorithms and allocate."""


class Recording:
    """The kernels of a function, recorded as a CUDA graph at its first call.

    Launching hundreds of small kernels one by one takes the host longer than the GPU needs for
    them. The function may not wait for the device, nor depend on anything but its argument and
    memory that stays where it is.

    Args:
        work: takes a tensor, returns one; both keep their shapes.
    """

    def __init__(self, work: Callable[[Tensor], Tensor]) -> None:
        self._work = work
        self._graphs: dict[torch.Size, tuple[torch.cuda.CUDAGraph, Tensor, Tensor]] = {}

    def __call__(self, argument: Tensor) -> Tensor:
        """Do the work; the result is overwritten by the next call with the same shape."""
        if argument.shape not in self._graphs:
            self._graphs[argument.shape] = self._record(argument)
        graph, taken, result = self._graphs[argument.shape]
        taken.copy_(argument)
        graph.replay()
        return result

    def _record(self, argument: Tensor) -> tuple[torch.cuda.CUDAGraph, Tensor, Tensor]:
        taken = argument.clone()
        side, here = torch.cuda.Stream(), torch.cuda.current_stream()
        side.wait_stream(here)
        with torch.cuda.stream(side):
            for _ in range(WARM_UPS):
                self._work(taken)
        here.wait_stream(side)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            result = self._work(taken)
        return graph, taken, result
