"""Step graph: the launches of an environment step, recorded once and replayed.

A step on a GPU launches some hundred small kernels, and launching them from Python takes longer
than running them for up to a thousand environments. Recorded, they are five launches: CUDA graphs
of torch's and Numba's kernels, cut where MuJoCo Warp launches a graph of its own. Warp's graphs are
not part of torch's because their solver loops end a capture and resume it, and torch's memory pool
would lose track of it.
"""

import warnings
from collections import defaultdict
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from knowarm.world.tasks.reach import VARYING, ReachTask

Launch = Callable[[], None]

Outputs = dict[str, Tensor]

WARM_UP_STEPS = 3
"""Steps that are executed before one is recorded: they compile kernels and allocate memory."""


class Recorder(Protocol):
    """Records launches."""

    executes: bool
    """Whether recorded launches are also executed; CUDA graphs only record."""

    def record(self, run: Launch) -> list[Launch]:
        """Call ``run`` and return what repeats its launches, in order."""

    def cut(self, launch: Launch) -> None:
        """Add a launch that is no kernel of torch or Numba, while recording."""


class CudaRecorder:
    """Records CUDA graphs that share a memory pool and are replayed in their order.

    Args:
        device: of the graphs; they are replayed on its current stream.
    """

    executes = False

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._launches: list[Launch] = []
        self._capture: Any = None

    def record(self, run: Launch) -> list[Launch]:
        """See ``Recorder.record``."""
        self._launches, self._pool = [], torch.cuda.graph_pool_handle()
        stream = torch.cuda.current_stream(self._device)
        try:
            self._begin()
            try:
                run()
            finally:
                self._end()
        except Exception:
            torch.cuda.set_stream(stream)  # an aborted capture leaves its own stream current
            raise
        return self._launches

    def cut(self, launch: Launch) -> None:
        """See ``Recorder.cut``."""
        self._end()
        self._launches.append(launch)
        self._begin()

    def _begin(self) -> None:
        graph = torch.cuda.CUDAGraph()
        self._capture = torch.cuda.graph(graph, pool=self._pool, capture_error_mode="thread_local")
        self._capture.__enter__()
        self._launches.append(graph.replay)

    def _end(self) -> None:
        self._capture.__exit__(None, None, None)


class Recorded(NamedTuple):
    """A recorded step and the memory that it reads and writes."""

    launches: list[Launch]
    actions: Tensor
    state: dict[str, Tensor | None]
    """Tensors of the task, by name; every replay reads and overwrites them."""
    packed: list[tuple[list[str], Tensor]]
    """Names of the outputs of a dtype and shape, and their values, (k, n, ...)."""
    images: Tensor


class StepGraph:
    """A step of a task that is executed at first and then replayed.

    Args:
        task: its tensors are overwritten in place by a replay. Where they were replaced since, by
            a reset for example, their values are copied first.
        play: plays one step with actions (n, J). It returns the outputs, (n, ...) each, and the
            images (n, H, W, 3); it may depend only on the task, and change nothing else.
        recorder: records the launches.
    """

    def __init__(
        self,
        task: ReachTask,
        play: Callable[[Tensor], tuple[Outputs, Tensor]],
        recorder: Recorder,
    ) -> None:
        self._task = task
        self._play = play
        self._recorder: Recorder | None = recorder
        self._steps = 0
        self._key: object = None
        self._recorded: Recorded | None = None

    def __call__(self, actions: Tensor, key: object = None) -> tuple[Outputs, Tensor]:
        """Play one step; outputs and images are new tensors.

        Args:
            actions: (n, J).
            key: what a step depends on besides tensors; a new value is recorded again.
        """
        self._steps += 1
        if key != self._key:
            self._key, self._recorded, self._steps = key, None, 1
        if self._recorder is None or self._steps <= WARM_UP_STEPS:
            return self._play(actions)
        if self._recorded is None:
            self._recorded = self._record(actions, self._recorder)
            if self._recorded is None:
                return self._play(actions)
            if self._recorder.executes:
                return self._outputs(self._recorded)
        recorded = self._recorded
        self._restore(recorded)
        recorded.actions.copy_(actions)
        for launch in recorded.launches:
            launch()
        return self._outputs(recorded)

    def _record(self, actions: Tensor, recorder: Recorder) -> Recorded | None:
        """Record a step; return None and execute all steps from now on if that is impossible."""
        task, before = self._task, _tensors(self._task)
        state = {name: None if old is None else old.clone() for name, old in before.items()}
        simulator: Any = task.simulator
        static_actions = actions.clone()
        results: list[Any] = []

        def run() -> None:
            outputs, images = self._play(static_actions)
            alike: defaultdict[Any, list[str]] = defaultdict(list)
            for name, values in outputs.items():
                alike[values.dtype, values.shape].append(name)
            packed = [
                (names, torch.stack([outputs[name] for name in names])) for names in alike.values()
            ]
            # Only now: outputs may be the task's own tensors.
            for name, new in _tensors(task).items():
                old = state[name]
                if old is not None and new is not None and new is not old:
                    old.copy_(new)
            results.extend((packed, images))

        _replace(task, state)
        simulator.launch = recorder.cut
        try:
            launches = recorder.record(run)
        except RuntimeError as error:
            self._recorder = None
            _replace(task, before)
            warnings.warn(
                f"The environment's step could not be recorded as CUDA graphs ({error}) and is "
                "launched kernel by kernel, which is slower for few environments.",
                RuntimeWarning,
                stacklevel=4,
            )
            return None
        finally:
            simulator.launch = _call
        _replace(task, state)
        return Recorded(launches, static_actions, state, *results)

    def _restore(self, recorded: Recorded) -> None:
        """Copy tensors that were replaced since the last step into the recorded memory."""
        for name, now in _tensors(self._task).items():
            kept = recorded.state[name]
            if kept is not None and now is not None and now is not kept:
                kept.copy_(now)
        _replace(self._task, recorded.state)

    def _outputs(self, recorded: Recorded) -> tuple[Outputs, Tensor]:
        """Copy the outputs, of which the next replay overwrites the originals."""
        outputs = {
            name: values
            for names, packed in recorded.packed
            for name, values in zip(names, packed.clone().unbind(), strict=True)
        }
        return outputs, recorded.images.clone()


def _call(launch: Launch) -> None:
    launch()


def _tensors(task: ReachTask) -> dict[str, Tensor | None]:
    """Return the tensors of a task that a step replaces, by name."""
    shown = {f"shown.{name}": getattr(task.shown, name) for name in task.shown._fields}
    return {name: getattr(task, name) for name in VARYING} | shown


def _replace(task: ReachTask, tensors: dict[str, Tensor | None]) -> None:
    for name in VARYING:
        setattr(task, name, tensors[name])
    task.shown = type(task.shown)(*(tensors[f"shown.{name}"] for name in task.shown._fields))
