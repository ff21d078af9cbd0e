"""Nothing goes in; the number of processor cores this process may use comes out."""

import os


def available_cores() -> int:
    """Number of cores this process may use; all of the machine's where the system cannot tell."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
