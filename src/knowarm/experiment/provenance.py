"""Provenance of a run: versions, commit, machine, sizes and options of its training."""

import os
import platform
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import psutil

from knowarm.cores import processor
from knowarm.knowledge.config import EmbeddingFacts

PACKAGES = ("knowarm", "torch", "mujoco", "numpy", "numba", "gymnasium", "safetensors")
"""Packages that shape a result."""
CHANGING = ("versions", "commit", "machine", "algorithm")
"""What may be another when a training resumes."""


Fact = str | int | float | None
"""A fact about a machine; None for what it does not tell."""
Options = Mapping[str, Any]
"""Options and sizes by name, as JSON values."""


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """What a run was trained with, and on: the content of ``provenance.json``."""

    versions: Mapping[str, str | None] = field(default_factory=dict)
    """Versions of Python and of `PACKAGES`."""
    commit: str | None = None
    """Commit of the checkout, with "+changes" for uncommitted edits; None outside of one."""
    machine: Mapping[str, Fact] = field(default_factory=dict)
    """System, processor, cores and memory."""
    parameter_counts: Mapping[str, int] = field(default_factory=dict)
    """Trainable parameters by part of the network, and in ``total``."""
    policy: Options = field(default_factory=dict)
    """``config`` and ``shape`` of the policy."""
    facets: tuple[tuple[str, str], ...] = ()
    """Object and colour of each facet."""
    knowledge: EmbeddingFacts | None = None
    """The knowledge vector."""
    perception: Options | None = None
    """Digest and specification of the grounding network, for agents that have one."""
    algorithm: Options = field(default_factory=dict)
    """Options of the learning algorithm."""
    resumed: tuple[Options, ...] = ()
    """Step and `CHANGING` of each resumption in which one of these was another than before."""


def provenance(**facts: Any) -> Provenance:
    """Return ``facts`` of a run with the versions, the commit, and the machine."""
    versions: dict[str, str | None] = {"python": platform.python_version()}
    for package in PACKAGES:
        versions[package] = _version(package)
    machine: dict[str, Fact] = {
        "system": f"{platform.system()} {platform.release()}",
        "processor": processor(),
        "cores": os.cpu_count(),
        "memory_gib": round(psutil.virtual_memory().total / 2**30, 1),
    }
    return Provenance(versions=versions, commit=_commit(), machine=machine, **facts)


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _commit() -> str | None:
    try:
        # Else another project's
        _git("ls-files", "--error-unmatch", Path(__file__).name)
        commit = _git("rev-parse", "HEAD")
        has_changes = _git("status", "--porcelain", "-uno")
    except (OSError, subprocess.CalledProcessError):
        return None  # installed from a wheel, or no git on the machine
    if has_changes:
        commit += "+changes"
    return commit


def _git(*arguments: str) -> str:
    """Run git in the folder of this file."""
    command = ["git", "-C", str(Path(__file__).parent), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stdout.strip()
