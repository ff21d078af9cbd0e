"""Cache of arrays that take long to compute: files named by a digest of what they follow from."""

import hashlib
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.reading import replacing


def cache_file(kind: str, *depends_on: object) -> Path:
    """Return the file of a result in a subfolder of ``KNOWARM_CACHE`` or the user's cache folder.

    ``depends_on`` is all that it follows from: arrays, and values that ``repr`` tells apart.
    """
    digest = hashlib.sha256()
    for value in depends_on:
        if isinstance(value, np.ndarray):
            digest.update(f"{value.dtype}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).tobytes())
        else:
            digest.update(f"{value!r};".encode())
    return _cache_folder() / kind / f"{digest.hexdigest()[:32]}.npz"


def _cache_folder() -> Path:
    folder = os.environ.get("KNOWARM_CACHE")
    if folder:
        return Path(folder)
    for name in ("XDG_CACHE_HOME", "LOCALAPPDATA"):
        root = Path(os.environ.get(name, ""))
        if root.is_absolute():
            return root / "knowarm"
    return Path.home() / ".cache" / "knowarm"


def read_arrays(file: Path) -> dict[str, NDArray[np.generic]] | None:
    """Read a result; None if there is no whole file."""
    try:
        with np.load(file, allow_pickle=False) as arrays:
            return dict(arrays)
    except Exception:  # NumPy and zipfile raise many types for damaged files
        return None


def write_arrays(file: Path, arrays: Mapping[str, NDArray[np.generic]]) -> None:
    """Store a result; a folder that cannot be written is no error."""
    with suppress(UserError), replacing(file) as temporary:
        np.savez(temporary, **arrays)  # type: ignore[arg-type]
