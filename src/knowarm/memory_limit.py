"""Limit of memory of this process, looked at before libraries are loaded."""

import sys

LEAST_MB = 600
"""With less, some libraries end the process without a reason, and some wait for ever [MB]."""


def check_memory_limit() -> None:
    """End the process with a line if its limit of memory is too small for NumPy and Numba."""
    try:
        import resource
    except ImportError:  # Windows has no limits
        return
    for kind in (resource.RLIMIT_AS, resource.RLIMIT_DATA):
        limit, _ = resource.getrlimit(kind)
        if 0 <= limit < LEAST_MB * 10**6:
            print(
                f"knowarm: memory is limited to {limit // 10**6} MB, and libraries need "
                f"{LEAST_MB} MB, PyTorch 1,500 MB. Start a shell without the limit that "
                "`ulimit -v` or `ulimit -d` prints.",
                file=sys.stderr,
            )
            raise SystemExit(2)
