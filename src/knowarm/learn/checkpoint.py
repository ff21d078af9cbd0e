"""Checkpoints: atomic writing, integrity check, and reading without running code.

A checkpoint is a folder of four files: ``policy.safetensors``, ``optimizer.safetensors``,
``state.safetensors`` and ``meta.json``, which holds the SHA-256 digests of the other three.
"""

import json
import logging
import operator
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from safetensors.numpy import load as load_arrays
from safetensors.numpy import save as save_arrays
from torch import Tensor, nn

from knowarm.config import differences
from knowarm.errors import UserError
from knowarm.reading import UnreadableFileError, digest, read_json, reading

log = logging.getLogger("knowarm.learn")

Arrays = dict[str, np.ndarray]
"""Arrays by name."""
Tensors = dict[str, Tensor]
"""Tensors by name."""
Description = Mapping[str, Any]
"""JSON values by name."""
FORMAT = 1
PARTS = ("policy", "optimizer", "state")


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """All that is needed to continue a training run."""

    policy: Arrays
    """Parameters of the policy by name."""
    optimizer: Arrays = field(default_factory=dict)
    """State of the optimizer."""
    state: Arrays = field(default_factory=dict)
    """Environments, generators, recurrent state, episode statistics."""
    facts: dict[str, Any] = field(default_factory=dict)
    """JSON values: step, best result, ..."""


class HasState(Protocol):
    """What checkpoints hold the state of."""

    def get_state(self) -> Arrays:
        """Return all that `set_state` needs."""

    def set_state(self, state: Arrays) -> None:
        """Continue from the result of `get_state`, among other arrays."""


class CheckpointStore:
    """The checkpoints ``latest``, ``previous`` and ``best`` of one run.

    Args:
        folder: parent folder of the three; created when first needed.
        description: what the checkpoints belong to (robot, agent, policy, algorithm), as flat
            JSON values; a checkpoint with another description is rejected.
        before_writing: called before a checkpoint is written; it may raise.
    """

    def __init__(
        self,
        folder: Path,
        description: Description,
        before_writing: Callable[[], None] = lambda: None,
    ) -> None:
        self.folder = folder
        self._before_writing = before_writing
        self.description = json.loads(json.dumps(dict(description)))

    def save(self, checkpoint: Checkpoint) -> None:
        """Save a checkpoint as ``latest``; the former latest becomes ``previous``.

        One of the two is complete at every moment: the new one is written to a temporary folder
        and renamed once it is on disk. `read_checkpoint` reads ``previous`` where the process
        ended between two renames.

        Raises:
            UserError: the disk is full or not writable; the former checkpoint is unchanged.
        """
        self._replace("latest", checkpoint)

    def save_best(self, checkpoint: Checkpoint) -> None:
        """Save a checkpoint as ``best``; raises as `save`."""
        self._replace("best", checkpoint)
        shutil.rmtree(_former(self.folder / "best"), ignore_errors=True)

    def load(self) -> Checkpoint:
        """Return the latest intact checkpoint.

        Raises:
            UserError: there is none, all are damaged, or they belong to another run.
        """
        problems = []
        for folder in (self.folder / "latest", self.folder / "previous"):
            if folder.is_dir():
                try:
                    return read_checkpoint(folder, self.description)
                except UnreadableFileError as error:
                    log.warning("%s", error)
                    problems.append(str(error))
        raise UserError(
            " ".join(problems)
            or f"There is no checkpoint in {self.folder}; start the training without resuming."
        )

    def _replace(self, name: str, checkpoint: Checkpoint) -> None:
        self._before_writing()
        path = self.folder / name
        temporary = self.folder / f".{name}-being-written"
        try:
            shutil.rmtree(temporary, ignore_errors=True)
            temporary.mkdir(parents=True)
            self._write(temporary, checkpoint)
            if path.exists():
                # A folder cannot be renamed onto a non-empty one: first move the former one away.
                shutil.rmtree(_former(path), ignore_errors=True)
                path.rename(_former(path))
            temporary.rename(path)
            _sync(self.folder)
        except OSError as error:
            shutil.rmtree(temporary, ignore_errors=True)
            raise UserError(
                f"The checkpoint of step {checkpoint.facts.get('step')} cannot be written to "
                f"{self.folder}: {error.strerror or error}. The former checkpoint is intact; free "
                "disk space and resume."
            ) from error

    def _write(self, folder: Path, checkpoint: Checkpoint) -> None:
        digests = {}
        for part in PARTS:
            arrays: Arrays = getattr(checkpoint, part)
            # safetensors writes the memory of an array whatever its strides are.
            contiguous = {
                name: np.asarray(array, order="C") for name, array in arrays.items()
            }
            data = save_arrays(contiguous)
            digests[part] = digest(data)
            _write_file(folder / f"{part}.safetensors", data)
        meta = {
            "format": FORMAT,
            "description": self.description,
            "facts": checkpoint.facts,
            "sha256": digests,
        }
        _write_file(folder / "meta.json", json.dumps(meta, indent=2).encode())
        _sync(folder)


def read_checkpoint(folder: Path, description: Description | None = None) -> Checkpoint:
    """Read a checkpoint folder and verify its digests.

    Args:
        folder: contains the four files.
        description: what the checkpoint must belong to, as JSON values; None accepts any.

    Raises:
        UnreadableFileError: a file is missing or differs from what was written.
        UserError: there is no such folder, or the checkpoint belongs to another run; the
            message shows both descriptions.
    """
    if not folder.is_dir() and _former(folder).is_dir():
        folder = _former(folder)  # saving ended between two renames
    if not folder.is_dir():
        others = ", ".join(sorted(path.name for path in folder.parent.glob("[!.]*")))
        raise UserError(
            f"There is no checkpoint {folder}. Available: {others or 'none'}."
        )
    remedy = "The checkpoint is incomplete: restore it or delete it."
    file = folder / "meta.json"
    meta = read_json(file, remedy=remedy)
    with reading(file, remedy):
        digests = dict(meta["sha256"])
        facts = dict(meta["facts"])
        written_for = dict(meta["description"])
        facts["step"] = operator.index(facts["step"])
    if description is not None:
        _compare(folder, written_for, description)
    arrays = {}
    for part in PARTS:
        path = folder / f"{part}.safetensors"
        with reading(path, remedy):
            data = path.read_bytes()
            if digest(data) != digests[part]:
                raise ValueError(f"its {len(data)} bytes differ from those written")
            arrays[part] = load_arrays(data)
    return Checkpoint(**arrays, facts=facts)


def _former(folder: Path) -> Path:
    """Return where a checkpoint is kept while it is being replaced."""
    if folder.name == "latest":
        return folder.with_name("previous")
    return folder.with_name(f".{folder.name}-old")


def select(state: Arrays, prefix: str) -> Arrays:
    """Return the entries whose names start with ``prefix``, without the prefix."""
    return {
        name.removeprefix(prefix): array
        for name, array in state.items()
        if name.startswith(prefix)
    }


def prefixed(prefix: str, state: Arrays) -> Arrays:
    """Return the entries with ``prefix`` before their names; `select` is the inverse."""
    return {f"{prefix}{name}": array for name, array in state.items()}


def to_arrays(tensors: Tensors) -> Arrays:
    """Copy tensors of any device."""
    return {
        name: tensor.detach().cpu().numpy().copy() for name, tensor in tensors.items()
    }


def to_tensors(arrays: Arrays, device: torch.device | None = None) -> Tensors:
    """Copy arrays to a device; None: the CPU."""
    return {name: torch.tensor(array, device=device) for name, array in arrays.items()}


def policy_arrays(policy: nn.Module) -> Arrays:
    """Copy the parameters of a policy, by name."""
    return to_arrays(policy.state_dict())


def _compare(folder: Path, written: Description, wanted: Description) -> None:
    """Raise a `UserError` that shows the differences between two descriptions."""
    different = sorted(differences(written, wanted).items())
    if different:
        pairs = "; ".join(f"{name}: {a!r} | {b!r}" for name, (a, b) in different)
        raise UserError(
            f"The checkpoint {folder} belongs to another run (checkpoint | this run): {pairs}. "
            "Resume it with its own settings or choose another run folder."
        )


def _write_file(path: Path, data: bytes) -> None:
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _sync(folder: Path) -> None:
    """Flush renames and new names in a folder to disk."""
    if os.name != "nt":  # Windows cannot open folders
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
