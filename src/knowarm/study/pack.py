"""Packs: a study as one file with what its report needs, and digests of everything in it."""

import gzip
import hashlib
import io
import json
import shutil
import tarfile
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Literal

from knowarm.errors import UserError, unknown_name
from knowarm.experiment.perceived import FILE as PERCEPTION
from knowarm.experiment.run import run_path
from knowarm.experiment.run_lock import lock_folder
from knowarm.study.config import FILE, PACKED
from knowarm.study.driver import open_study
from knowarm.study.status import FAILURE

FORMAT = 1
"""Version of the manifest."""

SUFFIX = ".tar.gz"

Part = Literal["policies", "steps", "films"]
"""What a pack may leave out: the best policies, every step of the evaluations, their images."""

RUN_FILES = (
    "config.json",
    "provenance.json",
    "knowledge.safetensors",
    "metrics.csv",
    "evaluations.csv",
    FAILURE,
    "checkpoints/latest/meta.json",  # the step that training reached
    "evaluation/*/summary.json",
    "evaluation/*/episodes.parquet",
)
"""Patterns of the files of a run that every pack holds."""

PART_FILES: dict[Part, tuple[str, ...]] = {
    "policies": ("checkpoints/best/*", PERCEPTION),
    "steps": ("evaluation/*/steps.parquet",),
    "films": ("evaluation/*/films/*",),
}
"""Patterns of the files of a run that belong to a part."""


def pack_study(out: Path, file: Path, *, leave_out: Collection[Part] = ()) -> int:
    """Write a study to one file, without optimizer state and rollouts; equal folders, equal bytes.

    Args:
        out: the study's folder; nothing may run in it.
        file: the pack, ``*.tar.gz``.
        leave_out: parts to leave out.

    Returns:
        Number of files in the pack, without its manifest.

    Raises:
        UserError: the study is running, or the file cannot be written.
    """
    for part in leave_out:
        if part not in PART_FILES:
            raise unknown_name("part of a pack", part, PART_FILES)
    if not file.name.endswith(SUFFIX):
        raise UserError(f"A pack is a {SUFFIX} file, got {file}.")
    study = open_study(out)
    patterns = [
        *RUN_FILES,
        *(each for name, files in PART_FILES.items() if name not in leave_out for each in files),
    ]
    with lock_folder(out, remedy="Stop it before packing: knowarm study stop."):
        paths = [out / FILE] + [
            path
            for config in study.runs()
            for pattern in patterns
            for path in sorted(run_path(out, config).glob(pattern))
            if path.is_file()
        ]
        contents = {path.relative_to(out).as_posix(): path.read_bytes() for path in paths}
    manifest = {
        "format": FORMAT,
        "study": study.name,
        "left_out": sorted(leave_out),
        "sha256": {name: hashlib.sha256(data).hexdigest() for name, data in contents.items()},
    }
    temporary = file.with_name(f".{file.name}.tmp")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with (
            temporary.open("wb") as raw,
            gzip.GzipFile("", "wb", fileobj=raw, mtime=0) as zipped,
            tarfile.open(fileobj=zipped, mode="w", format=tarfile.PAX_FORMAT) as archive,
        ):
            text = json.dumps(manifest, indent=2) + "\n"
            for name, data in ({PACKED: text.encode()} | contents).items():
                member = tarfile.TarInfo(name)
                member.size = len(data)
                archive.addfile(member, io.BytesIO(data))
        temporary.replace(file)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise UserError(f"Cannot write {file}: {error.strerror or error}.") from error
    return len(contents)


def unpack_study(file: Path, out: Path) -> Path:
    """Write the files of a pack to a new folder, and compare each with its digest.

    Returns:
        ``out``, which `knowarm report` and `knowarm evaluate` read; its runs cannot be resumed.

    Raises:
        UserError: the folder exists, or the file is no intact pack.
    """
    if out.exists():
        raise UserError(f"{out} exists: choose another folder, or remove it.")
    temporary = out.with_name(f".{out.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    try:
        contents = dict(_members(file))
        manifest = json.loads(contents[PACKED])
        found = {
            name: hashlib.sha256(data).hexdigest()
            for name, data in contents.items()
            if name != PACKED
        }
        different = sorted(
            name
            for name in {*found, *manifest["sha256"]}
            if found.get(name) != manifest["sha256"].get(name)
        )
        if different:
            raise ValueError(f"{', '.join(different[:3])} is missing or was changed")
        for name, data in contents.items():
            path = temporary / name
            if temporary.absolute() not in path.resolve().parents:
                raise ValueError(f"{name} lies outside of the pack")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        temporary.rename(out)
    except (tarfile.TarError, EOFError, ValueError, KeyError, TypeError, gzip.BadGzipFile) as error:
        raise UserError(f"{file} is no intact pack of a study: {error}.") from error
    except OSError as error:
        raise UserError(f"Cannot unpack {file}: {error.strerror or error}.") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return out


def _members(file: Path) -> Iterator[tuple[str, bytes]]:
    with tarfile.open(file, "r:gz") as archive:
        for member in archive:
            reader = archive.extractfile(member)
            if reader is None:
                raise ValueError(f"{member.name} is no file")
            yield member.name, reader.read()
