"""Private APIs of other libraries: every use in KnowArm, with its reason.

tests/test_private_apis.py fails where a new version of a library lacks one of them.
"""

import atexit
import inspect
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cached_property, update_wrapper
from types import CellType, FunctionType
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

if TYPE_CHECKING:  # takes a second to import, and the command line imports this module
    from torch.optim import Optimizer

    OptimizerT = TypeVar("OptimizerT", bound=Optimizer)


def cpu_has_bfloat16() -> bool:
    """Tell whether the CPU multiplies bfloat16 matrices in hardware (AVX512-BF16 or AMX).

    Reason: ``torch.backends.cpu.get_cpu_capability`` leaves out both extensions.
    """
    import torch  # takes a second to import, and the command line imports this module

    return bool(
        torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()
    )


def without_compiler(optimizer: "type[OptimizerT]") -> "type[OptimizerT]":
    """Return a subclass of an optimizer that does not import PyTorch's compiler.

    Reason: `torch.optim` imports the compiler, a third of the time in which a training starts, only
    to mark what it should not compile, and no option prevents it. A method that is its own mark is
    called without the import. The marks hold for all optimizers of the process.
    """
    from torch import no_grad

    for name in ("add_param_group", "load_state_dict", "state_dict", "zero_grad"):
        method = inspect.unwrap(getattr(optimizer, name))
        method.__dynamo_disable = method
    step = no_grad()(inspect.unwrap(optimizer.step))
    return type(optimizer.__name__, (optimizer,), {"step": step})


def key_numba_cache(function: Callable[..., Any], key: str) -> Callable[..., Any]:
    """Return a copy of a function that Numba caches on disk under a key, such as a digest.

    Reason: Numba's key covers the function's own file only, not the files of the functions that it
    calls, and no option extends it. It also covers the closure variables, hence the string becomes
    the only one of the function.
    """
    code = function.__code__.replace(co_freevars=("key",))
    keyed = FunctionType(code, function.__globals__, closure=(CellType(key),))
    return update_wrapper(keyed, function)


def unlock_cached_properties() -> None:
    """Let this process, which is a fork, compute cached properties without a lock.

    Reason: Python 3.11 computes them under a lock of their class, which a thread may hold while the
    process forks; the fork, which lacks that thread, would wait for ever.
    """
    if sys.version_info >= (3, 12):
        return

    def get(self: Any, instance: Any, owner: Any = None) -> Any:
        if instance is None:
            return self
        if self.attrname not in instance.__dict__:
            instance.__dict__[self.attrname] = self.func(instance)
        return instance.__dict__[self.attrname]

    cached_property.__get__ = get  # type: ignore[method-assign]


def end_process(code: int) -> NoReturn:
    """End this process without freeing its objects.

    Reason: at a normal exit the interpreter collects PyTorch's objects, which takes up to 20
    seconds on a busy machine. Functions registered with ``atexit`` are still called, and pools of
    threads ended.
    """
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(
            OSError, ValueError, AttributeError
        ):  # closed, or nobody reads it
            stream.flush()
    os._exit(code)


@contextmanager
def xacro_packages(find: Callable[[str], str]) -> Iterator[None]:
    """Replace the function by which xacro finds the folder of a ROS package.

    Reason: xacro asks the index of an installed ROS 2, and has no option to give folders.
    """
    from xacro import substitution_args as module

    def replace(function: Callable[[str], str]) -> None:
        module._eval_find = function
        module._eval_dict["find"] = function

    before = module._eval_find
    replace(find)
    try:
        yield
    finally:
        replace(before)
