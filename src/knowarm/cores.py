"""The processor: its name and the number of cores this process may use."""

import os
import platform
from pathlib import Path


def available_cores() -> int:
    """Count the cores this process may use: its CPU affinity where the system reports one."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def processor() -> str:
    """Return the model name of the processor, or the architecture where there is no model name."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
