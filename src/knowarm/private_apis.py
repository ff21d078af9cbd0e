"""Private APIs of other libraries: every use in KnowArm, with its reason.

tests/test_private_apis.py fails where a new version of a library lacks one of them.
"""

import atexit
import inspect
import multiprocessing.process
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial, update_wrapper
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import CellType, FunctionType
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import numpy as np

from knowarm.errors import UserError

if TYPE_CHECKING:  # takes a second to import, and the command line imports this module
    from torch.optim import Optimizer

    OptimizerT = TypeVar("OptimizerT", bound=Optimizer)


def cpu_has_bfloat16() -> bool:
    """Tell whether the CPU multiplies bfloat16 matrices in hardware (AVX512-BF16 or AMX).

    PyTorch has no public function for it: ``torch.backends.cpu.get_cpu_capability`` names the
    vector instructions and leaves out both extensions.
    """
    import torch  # takes a second to import, and the command line imports this module

    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())


def without_compiler(optimizer: "type[OptimizerT]") -> "type[OptimizerT]":
    """Return an optimizer that does not import PyTorch's compiler.

    Reason: `torch.optim` imports the compiler, a third of the time in which a training starts, only
    to mark what it should not compile, and no option prevents it. The mark of a method is looked up
    before the import: with the method itself as its mark, the method is called as it is. The marks
    are on PyTorch's own methods, so they hold for all optimizers of the process.

    Args:
        optimizer: a class of `torch.optim`.

    Returns:
        A subclass with the same steps and state.
    """
    from torch import no_grad

    for name in ("add_param_group", "load_state_dict", "state_dict", "zero_grad"):
        method = inspect.unwrap(getattr(optimizer, name))
        method.__dynamo_disable = method
    step = no_grad()(inspect.unwrap(optimizer.step))
    return type(optimizer.__name__, (optimizer,), {"step": step})


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


def keep_temporary_files_in(folder: Path) -> None:
    """Let multiprocessing keep the sockets of this process in a folder.

    Reason: it makes a folder with a random name, which stays for ever when the process is killed,
    and no later process can tell that it is not in use.
    """
    config = multiprocessing.process.current_process()._config  # type: ignore[attr-defined]
    config.setdefault("tempdir", str(folder))


def end_process(code: int) -> NoReturn:
    """End this process without freeing its objects.

    Reason: at a normal exit the interpreter collects PyTorch's objects, which takes a second, and
    20 seconds on a busy machine, where a training must end soon after SIGTERM. Functions registered
    with ``atexit`` are still called, and pools of threads ended, by private functions.

    Args:
        code: exit code.
    """
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # closed, or nobody reads it
            stream.flush()
    os._exit(code)


def release_fork_server() -> None:
    """Let the fork server exit before this child process of it.

    Reason: every child inherits the pipe whose other end tells the fork server that it is still
    needed, for processes that the child might start itself. A child that is stopped for ever would
    keep the fork server alive, and the server's exit is what kills such children (`processes`).
    Does nothing in a process that no fork server started.
    """
    from multiprocessing import forkserver

    server: Any = forkserver._forkserver
    if server._forkserver_pid is None and server._forkserver_alive_fd is not None:
        os.close(server._forkserver_alive_fd)
        server._forkserver_alive_fd = None


def import_numba_cuda() -> Any:
    """Import Numba's CUDA target; with NumPy 2.5 or newer, also the part that fails there later.

    Reason: numba-cuda 0.30.4 asks NumPy for ``row_stack`` when it first compiles a kernel, and
    NumPy 2.5 removed this name of ``vstack``. NumPy has it for as long as the import lasts.
    """
    import numba.cuda

    simulated = numba.config.ENABLE_CUDASIM  # type: ignore[attr-defined]
    is_compiler = find_spec("numba_cuda") is not None and not simulated
    if is_compiler and not hasattr(np, "row_stack"):
        np.row_stack = np.vstack  # noqa: NPY201
        try:
            import_module("numba.cuda.np.npyimpl")
        finally:
            del np.row_stack  # noqa: NPY201
    return numba.cuda


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


@contextmanager
def guarded_web_viewer(
    bind: Callable[..., Any],
    guard: Callable[[Callable[..., Any]], Callable[..., Any]],
    announce: Callable[..., None],
    open_browser: Callable[..., None],
) -> Iterator[None]:
    """Change how MuJoCo's web viewer listens and answers, as long as this context lasts.

    Reason: the viewer listens on all interfaces, answers any Host and Origin, and has no option to
    change either.

    Args:
        bind: returns the listening socket.
        guard: wraps the server's function for requests.
        announce: prints the address.
        open_browser: opens the page.

    Raises:
        UserError: this version of the viewer has other functions; nothing was started.
    """
    from mujoco.studio import web_viewer
    from mujoco.studio.web import web_server

    serve = web_server.serve

    def guarded_serve(*args: Any, process_request: Callable[..., Any], **options: Any) -> Any:
        return serve(*args, process_request=guard(process_request), **options)

    replaced = [
        (web_server, "bind_public_socket", bind),
        (web_server, "serve", guarded_serve),
        (web_viewer, "_print_url_banner", announce),
        (web_viewer, "_open_browser", open_browser),
    ]
    if missing := [name for module, name, _ in replaced if not hasattr(module, name)]:
        raise UserError(
            f"This version of mujoco-studio lacks {missing[0]}, so the viewer cannot be kept from "
            "listening on the network. Install the version that KnowArm was tested with, or record "
            "with --video or --strip."
        )
    before = [getattr(module, name) for module, name, _ in replaced]
    try:
        for module, name, function in replaced:
            setattr(module, name, function)
        yield
    finally:
        for (module, name, _), function in zip(replaced, before, strict=True):
            setattr(module, name, function)
