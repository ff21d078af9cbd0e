"""The processor: its name, the cores this process may use, and PyTorch's threads."""

import os
import platform
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

LIMIT = "KNOWARM_CORES"
"""Environment variable: the most cores that a process and its children shall use."""


def available_cores() -> int:
    """Count the cores this process may use: its CPU affinity, at most `LIMIT`."""
    cores = os.cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    limit = os.environ.get(LIMIT, "")
    if limit.isdigit() and int(limit):
        return min(cores, int(limit))
    return cores


def limited_to(cores: int) -> dict[str, str]:
    """Return the environment variables of a process that shall use so many cores."""
    names = (LIMIT, "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    return dict.fromkeys(names, str(cores))


def processor() -> str:
    """Return the model name of the processor, or the architecture where there is no model name."""
    with suppress(OSError):
        model = re.search(
            r"model name\s*:(.*)", Path("/proc/cpuinfo").read_text("utf-8")
        )
        if model is not None:
            return model[1].strip()
    return platform.processor() or platform.machine()


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Let PyTorch use so many threads in a context: their number decides how sums are rounded."""
    import torch  # takes seconds, and the command line imports this module

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
