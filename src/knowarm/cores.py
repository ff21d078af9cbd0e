"""The processor: its name and the number of cores this process may use."""

import os
import platform
import re
from contextlib import suppress
from pathlib import Path

LIMIT = "KNOWARM_CORES"
"""Environment variable: the most cores that a process and its children shall use."""


def available_cores() -> int:
    """Count the cores this process may use: its CPU affinity, at most `LIMIT`."""
    has_affinity = hasattr(os, "sched_getaffinity")
    cores = len(os.sched_getaffinity(0)) if has_affinity else os.cpu_count() or 1
    limit = os.environ.get(LIMIT, "")
    return min(cores, int(limit)) if limit.isdigit() and int(limit) else cores


def limited_to(cores: int) -> dict[str, str]:
    """Return the environment variables of a process that shall use so many cores."""
    names = (LIMIT, "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    return dict.fromkeys(names, str(cores))


def processor() -> str:
    """Return the model name of the processor, or the architecture where there is no model name."""
    with suppress(OSError):
        if found := re.search(r"model name\s*:(.*)", Path("/proc/cpuinfo").read_text()):
            return found[1].strip()
    return platform.processor() or platform.machine()
