"""Arrays and facts of a running training go in; checkpoints that are whole or not there come out.

A checkpoint is a folder of four files: ``policy.safetensors``, ``optimizer.safetensors``,
``state.safetensors`` and ``meta.json``, which names the digest of the other three. Loading one
runs no code.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load as load_arrays
from safetensors.numpy import save as save_arrays
from torch import nn

from knowarm.errors import UserError

Arrays = dict[str, np.ndarray]
FORMAT = 1
PARTS = ("policy", "optimizer", "state")


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """Everything a training needs to go on."""

    policy: Arrays
    """Parameters by name."""
    optimizer: Arrays = field(default_factory=dict)
    """Statistics of the optimizer."""
    state: Arrays = field(default_factory=dict)
    """Environments, generators, recurrent state, episode statistics."""
    facts: dict[str, Any] = field(default_factory=dict)
    """JSON values: step, best result, ..."""


class CheckpointStore:
    """The folder ``checkpoints/`` of one run: ``latest``, ``previous`` and ``best``.

    Args:
        folder: where the three live; made when first needed.
        description: what the checkpoints belong to (robot, agent, network, algorithm), as flat
            JSON values; a checkpoint with another description is refused.
    """

    def __init__(self, folder: Path, description: Mapping[str, Any]) -> None:
        self.folder = folder
        self.description = json.loads(json.dumps(dict(description)))

    def save(self, checkpoint: Checkpoint) -> None:
        """Make this the latest checkpoint; the one before becomes ``previous``.

        At every moment one of the two is whole: the new one is written to a folder of its own
        and renamed when it has reached the disk.

        Raises:
            UserError: the disk is full or not writable; the checkpoint before is untouched.
        """
        self._replace("latest", checkpoint, keep="previous")

    def save_best(self, checkpoint: Checkpoint) -> None:
        """Make this the best policy so far. Errors as in `save`."""
        self._replace("best", checkpoint, keep=None)

    def load(self) -> Checkpoint:
        """Return the latest whole checkpoint.

        Raises:
            UserError: there is none, all are damaged, or they belong to something else.
        """
        problems = []
        for name in ("latest", "previous"):
            if (self.folder / name).is_dir():
                try:
                    return read_checkpoint(self.folder / name, self.description)
                except DamagedCheckpointError as error:
                    problems.append(str(error))
        raise UserError(
            " ".join(problems)
            or f"There is no checkpoint in {self.folder}; start the training without resuming."
        )

    def load_best(self) -> Checkpoint:
        """Return the best policy. Errors as in `load`."""
        return read_checkpoint(self.folder / "best", self.description)

    def _replace(self, name: str, checkpoint: Checkpoint, keep: str | None) -> None:
        fresh = self.folder / f".{name}-being-written"
        try:
            shutil.rmtree(fresh, ignore_errors=True)
            fresh.mkdir(parents=True)
            self._write(fresh, checkpoint)
            if keep is not None and (self.folder / name).exists():
                shutil.rmtree(self.folder / keep, ignore_errors=True)
                (self.folder / name).rename(self.folder / keep)
            elif (self.folder / name).exists():
                # A folder cannot be renamed over a full one: the old best steps aside first.
                aside = _aside(self.folder / name)
                shutil.rmtree(aside, ignore_errors=True)
                (self.folder / name).rename(aside)
            fresh.rename(self.folder / name)
            _sync(self.folder)
            shutil.rmtree(_aside(self.folder / name), ignore_errors=True)
        except OSError as error:
            shutil.rmtree(fresh, ignore_errors=True)
            raise UserError(
                f"The checkpoint of step {checkpoint.facts.get('step')} cannot be written to "
                f"{self.folder}: {error.strerror or error}. The checkpoint before is intact; free "
                "the disk and resume."
            ) from error

    def _write(self, folder: Path, checkpoint: Checkpoint) -> None:
        digests = {}
        for part in PARTS:
            arrays = {k: np.asarray(v, order="C") for k, v in getattr(checkpoint, part).items()}
            data = save_arrays(arrays)
            digests[part] = hashlib.sha256(data).hexdigest()
            _write_file(folder / f"{part}.safetensors", data)
        meta = {
            "format": FORMAT,
            "description": self.description,
            "facts": checkpoint.facts,
            "sha256": digests,
        }
        _write_file(folder / "meta.json", json.dumps(meta, indent=2).encode())
        _sync(folder)


class DamagedCheckpointError(UserError):
    """A checkpoint is incomplete, truncated or changed."""


def read_checkpoint(folder: Path, description: Mapping[str, Any] | None = None) -> Checkpoint:
    """Read one checkpoint folder and prove it whole.

    Args:
        folder: holds the four files.
        description: what the checkpoint must belong to; None takes any.

    Raises:
        DamagedCheckpointError: a file is missing or is not what was written.
        UserError: there is no such folder, or the checkpoint belongs to something else; the
            message shows both descriptions side by side.
    """
    if not folder.is_dir() and _aside(folder).is_dir():
        # Writing ended between two renames: the one before is whole and stands aside.
        folder = _aside(folder)
    if not folder.is_dir():
        raise UserError(f"There is no checkpoint in {folder}.")
    try:
        meta = json.loads((folder / "meta.json").read_text())
        digests, facts = meta["sha256"], meta["facts"]
        written_for = meta["description"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DamagedCheckpointError(
            f"{folder / 'meta.json'} is missing or damaged ({error}); it is no whole checkpoint."
        ) from error
    if description is not None:
        _compare(folder, written_for, json.loads(json.dumps(dict(description))))
    parts = {}
    for part in PARTS:
        path = folder / f"{part}.safetensors"
        try:
            data = path.read_bytes()
            if hashlib.sha256(data).hexdigest() != digests[part]:
                raise ValueError(f"its {len(data)} bytes are not those that were written")
            parts[part] = load_arrays(data)
        except (OSError, ValueError, KeyError, SafetensorError) as error:
            raise DamagedCheckpointError(f"{path} is damaged: {error}.") from error
    return Checkpoint(**parts, facts=facts)


def _aside(folder: Path) -> Path:
    """Where a checkpoint waits while another takes its place."""
    return folder.with_name(f".{folder.name}-old")


def policy_arrays(policy: nn.Module) -> Arrays:
    """Copy the parameters of a policy, by name."""
    return {k: v.detach().cpu().numpy().copy() for k, v in policy.state_dict().items()}


def _compare(folder: Path, written: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    different = [key for key in sorted({*written, *wanted}) if written.get(key) != wanted.get(key)]
    if different:
        pairs = "; ".join(f"{k}: {written.get(k)!r} | {wanted.get(k)!r}" for k in different)
        raise UserError(
            f"The checkpoint {folder} belongs to something else (checkpoint | this run): {pairs}. "
            "Resume it with its own settings or choose another run folder."
        )


def _write_file(path: Path, data: bytes) -> None:
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _sync(folder: Path) -> None:
    """Make renames and new names in a folder reach the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
