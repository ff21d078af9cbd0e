"""Recorder of torch's operations on the CPU, in place of CUDA graphs."""

from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves


class Tape(TorchDispatchMode):
    """A ``Recorder`` of torch's operations with the memory they read and wrote, as CUDA graphs are.

    Values that Python computed from a tensor are not read again, so a step that depends on them,
    or on tensors of an earlier step, replays something else than it executed.
    """

    executes = True

    def capture(self, run: Any) -> Any:
        """Record as `knowarm.learn.device.capture_cuda_graph` does."""
        launches = self.record(run)
        return lambda: [launch() for launch in launches]

    def record(self, run: Any) -> list[Any]:
        self.launches: list[Any] = []
        with self:
            run()
        return self.launches

    def cut(self, launch: Any) -> None:
        launch()
        self.launches.append(launch)

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = func(*args, **(kwargs or {}))
        places = {
            x.untyped_storage().data_ptr() for x in tree_leaves((args, kwargs)) if is_tensor(x)
        }

        def replay() -> None:
            new = func(*args, **(kwargs or {}))
            for old, values in zip(tree_leaves(result), tree_leaves(new), strict=True):
                if is_tensor(old) and old.untyped_storage().data_ptr() not in places:
                    old.copy_(values)

        self.launches.append(replay)
        return result


def is_tensor(value: Any) -> bool:
    return isinstance(value, torch.Tensor)
