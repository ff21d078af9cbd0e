"""Every use of another library's private API, each with its reason.

``tests/test_private_apis.py`` fails when an upgrade of a library breaks one of them.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial, update_wrapper
from types import CellType, FunctionType
from typing import Any


def key_numba_cache(function: Callable[..., Any], key: str) -> Callable[..., Any]:
    """Make a string part of the key under which Numba caches a function on disk.

    Reason: Numba's key covers the function's own file only, not the files of the functions that it
    calls, so an edit there would go unnoticed, and no option extends the key. The key also covers
    the closure variables, hence the string becomes one.

    Args:
        function: a Python function without closure variables, to be compiled with ``cache=True``.
        key: for instance a digest of the source files of all functions that are called.

    Returns:
        A copy of the function with ``key`` as its closure variable.
    """
    code = function.__code__.replace(co_freevars=("key",))
    keyed = FunctionType(code, function.__globals__, closure=(CellType(key),))
    return update_wrapper(keyed, function)


@contextmanager
def no_fused_multiply_add() -> Iterator[None]:
    """Compile the CUDA kernels that are first launched inside this context without FMA.

    Reason: a fused multiply-add rounds once where the CPU rounds twice, and images of CPU and GPU
    must be equal. NVVM has the option ``fma``; ``numba.cuda.jit`` does not pass it on, so it is set
    where Numba calls NVVM.
    """
    from numba.cuda.cudadrv import nvvm

    compile_ir = getattr(nvvm, "compile_ir", None)
    if compile_ir is None:  # Numba's CUDA simulator compiles nothing.
        yield
        return
    nvvm.compile_ir = partial(compile_ir, fma=False)
    try:
        yield
    finally:
        nvvm.compile_ir = compile_ir
