"""Device support: precision of matrix products, CUDA graphs and timing."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal

import torch
from torch import Tensor

from knowarm.errors import UserError
from knowarm.policy import MatmulPrecision
from knowarm.private_apis import cpu_has_bfloat16

PrecisionChoice = Literal["auto"] | MatmulPrecision

WARM_UP_CALLS = 3
"""Calls before a CUDA graph is captured: the first ones select algorithms and allocate memory."""


def resolve_precision(choice: PrecisionChoice, device: torch.device) -> MatmulPrecision:
    """Return the precision that a choice means on a device.

    "auto" is bfloat16 where the device computes it in hardware, else float32.

    Raises:
        UserError: "tf32" on the CPU.
    """
    on_gpu = device.type == "cuda"
    if choice == "tf32" and not on_gpu:
        raise UserError(
            "matmul_precision 'tf32' exists on GPUs only; on the CPU choose 'auto', 'float32' or "
            "'bfloat16'."
        )
    if choice != "auto":
        return choice
    fast = torch.cuda.is_bf16_supported() if on_gpu else cpu_has_bfloat16()
    return "bfloat16" if fast else "float32"


@contextmanager
def tf32_products(precision: MatmulPrecision, device: torch.device) -> Iterator[None]:
    """Round a GPU's float32 matrix products to TF32 within the context if ``precision`` is it."""
    if device.type != "cuda":
        yield
        return
    matmul, cudnn = torch.backends.cuda.matmul, torch.backends.cudnn
    before = matmul.allow_tf32, cudnn.allow_tf32
    matmul.allow_tf32 = cudnn.allow_tf32 = precision == "tf32"
    try:
        yield
    finally:
        matmul.allow_tf32, cudnn.allow_tf32 = before


class CudaGraph:
    """A function of one tensor, captured as a CUDA graph at its first call with a shape.

    Launching hundreds of small kernels one by one takes the host longer than the GPU needs to run
    them. The function must not synchronize with the device, and may depend only on its argument
    and on memory that keeps its address.

    Args:
        function: takes one tensor and returns one; both keep their shapes.
    """

    def __init__(self, function: Callable[[Tensor], Tensor]) -> None:
        self._function = function
        self._graphs: dict[torch.Size, tuple[torch.cuda.CUDAGraph, Tensor, Tensor]] = {}

    def __call__(self, argument: Tensor) -> Tensor:
        """Replay the graph; the next call with the same shape overwrites the result."""
        if argument.shape not in self._graphs:
            self._graphs[argument.shape] = self._capture(argument)
        graph, static_input, result = self._graphs[argument.shape]
        static_input.copy_(argument)
        graph.replay()
        return result

    def _capture(self, argument: Tensor) -> tuple[torch.cuda.CUDAGraph, Tensor, Tensor]:
        static_input = argument.clone()
        side, current = torch.cuda.Stream(), torch.cuda.current_stream()
        side.wait_stream(current)
        with torch.cuda.stream(side):
            for _ in range(WARM_UP_CALLS):
                self._function(static_input)
        current.wait_stream(side)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            result = self._function(static_input)
        return graph, static_input, result


class Stopwatch:
    """Total time between calls of `start` and `stop`; on a GPU measured there, without waiting.

    Args:
        device: where the timed work runs.
    """

    def __init__(self, device: torch.device) -> None:
        self._on_gpu = device.type == "cuda"
        self._seconds = 0.0
        self._started = 0.0
        self._events: list[tuple[torch.cuda.Event, torch.cuda.Event]] = []

    def start(self) -> None:
        """Start an interval."""
        if self._on_gpu:
            pair = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
            pair[0].record()
            self._events.append(pair)
        else:
            self._started = time.perf_counter()

    def stop(self) -> None:
        """End the interval."""
        if self._on_gpu:
            self._events[-1][1].record()
        else:
            self._seconds += time.perf_counter() - self._started

    def seconds(self) -> float:
        """Return the total of all intervals [s]; synchronizes with a GPU."""
        for first, last in self._events:
            last.synchronize()
            self._seconds += first.elapsed_time(last) / 1000
        self._events = []
        return self._seconds
