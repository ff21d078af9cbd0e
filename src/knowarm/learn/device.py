"""Device support: precision of matrix products, CUDA graphs and timing."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Literal

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


def capture_cuda_graph(run: Callable[[], None]) -> Callable[[], None]:
    """Record the launches of ``run`` as a CUDA graph; return what replays them."""
    side, current = torch.cuda.Stream(), torch.cuda.current_stream()
    side.wait_stream(current)
    with torch.cuda.stream(side):
        for _ in range(WARM_UP_CALLS):
            run()
    current.wait_stream(side)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        run()
    replay: Callable[[], None] = graph.replay
    return replay


class CudaGraph:
    """A function of tensors, captured as a CUDA graph at its first call with their shapes.

    Launching hundreds of small kernels one by one takes the host longer than the GPU needs to run
    them. The function must not synchronize with the device, and may depend only on its arguments
    and on memory that keeps its address.

    Args:
        function: takes tensors and returns one or several; all keep their shapes.
        capture: records the launches of a function and returns what repeats them.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        capture: Callable[[Callable[[], None]], Callable[[], None]] = capture_cuda_graph,
    ) -> None:
        self._function = function
        self._capture = capture
        self._graphs: dict[
            tuple[torch.Size, ...], tuple[Callable[[], None], list[Tensor], Any]
        ] = {}

    def __call__(self, *arguments: Tensor) -> Any:
        """Replay the graph; the next call with the same shapes overwrites the results."""
        shapes = tuple(argument.shape for argument in arguments)
        if shapes not in self._graphs:
            self._graphs[shapes] = self._record([argument.clone() for argument in arguments])
        replay, inputs, results = self._graphs[shapes]
        for static, argument in zip(inputs, arguments, strict=True):
            static.copy_(argument)
        replay()
        return results

    def _record(self, inputs: list[Tensor]) -> tuple[Callable[[], None], list[Tensor], Any]:
        results: Any = None

        def run() -> None:
            nonlocal results
            results = self._function(*inputs)

        replay = self._capture(run)
        return replay, inputs, results


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
