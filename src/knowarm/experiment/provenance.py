"""Provenance of a run: versions of packages, commit and machine."""

import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import psutil

from knowarm.cores import processor

PACKAGES = ("knowarm", "torch", "mujoco", "numpy", "numba", "gymnasium", "safetensors")
"""Packages that shape a result."""


def provenance() -> dict[str, Any]:
    """Return the versions of `PACKAGES`, the commit, and the machine."""
    return {
        "versions": {"python": platform.python_version()} | {n: _version(n) for n in PACKAGES},
        "commit": _commit(),
        "machine": {
            "system": f"{platform.system()} {platform.release()}",
            "processor": processor(),
            "cores": os.cpu_count(),
            "memory_gib": round(psutil.virtual_memory().total / 2**30, 1),
        },
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _commit() -> str | None:
    """Commit of the checkout the package runs from, with "+changes" for uncommitted edits."""
    here = Path(__file__).parent
    try:
        commit = _git("rev-parse", "HEAD", at=here)
        return commit + ("+changes" if _git("status", "--porcelain", "-uno", at=here) else "")
    except (OSError, subprocess.CalledProcessError):
        return None  # installed from a wheel, or no git on the machine


def _git(*arguments: str, at: Path) -> str:
    command = ["git", "-C", str(at), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
