"""Nothing goes in; a process that keeps freed memory for its next tensors comes out."""

import ctypes
import sys

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_KEEP_BYTES = 1 << 30


def keep_freed_memory() -> bool:
    """Let the C library keep up to 1 GiB of freed memory instead of returning it at once.

    A gradient step allocates tensors of tens of megabytes, frees them, and does so again. By
    default glibc maps such blocks afresh each time, and the kernel zeroes every page: a third of
    an update's time on two cores (docs/learning.md). Only glibc knows the two switches.

    Returns:
        Whether the C library took both switches.
    """
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    return bool(mallopt(_MMAP_THRESHOLD, _KEEP_BYTES)) and bool(
        mallopt(_TRIM_THRESHOLD, 2 * _KEEP_BYTES - 1)
    )
