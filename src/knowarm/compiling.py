"""Numba's compiler for kernels, with a folder for its cache wherever the package is installed."""

import atexit
import logging
import os
import shutil
import tempfile

from knowarm.errors import UserError

try:
    from numba import config
    from numba import njit as njit
except ValueError as error:  # of its environment variables
    raise UserError(f"Numba does not start, see NUMBA_NUM_THREADS: {error}") from None


def _probe() -> None:
    """Stand for a kernel; never compiled."""


def provide_cache() -> None:
    """Make a temporary folder for compiled kernels if Numba finds none, and would not compile."""
    try:
        njit(cache=True)(_probe)
    except RuntimeError:
        folder = tempfile.mkdtemp(prefix="knowarm-kernels-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        # Child processes read the variable; this process has read it already.
        config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"] = folder  # type: ignore[attr-defined]
        logging.getLogger("knowarm").warning(
            "Neither the package's folder nor the user's cache folder can be written to, so every "
            "start compiles all kernels. Set NUMBA_CACHE_DIR to a folder of your own."
        )


provide_cache()
