"""Packs: a study as one file with what its report needs, and digests of everything in it."""

import csv
import io
import json
import lzma
import tarfile
from collections.abc import Collection
from fnmatch import fnmatch
from pathlib import Path
from typing import Literal

from knowarm.errors import UserError, shell_command, unknown_name
from knowarm.experiment.run import run_path
from knowarm.experiment.run_folder import POLICY_FILES, RUN_FILES, RunFolder
from knowarm.experiment.run_lock import lock_folder
from knowarm.reading import digest, new_folder, read_bytes, reading, replacing
from knowarm.study.config import PACKED, STUDY_FILE
from knowarm.study.driver import open_study
from knowarm.study.status import FAILURE, is_trained

FORMAT = 1  # of the manifest
SUFFIX = ".tar.xz"

Part = Literal["policies", "episodes", "steps", "films", "losses"]
"""What a pack may leave out: the best policies; of evaluations the episodes, steps and images; of
``metrics.csv`` the columns that no report reads."""

METRICS = "metrics.csv"
REPORTED_METRICS = ("step", "wall_time_s", "steps_per_s", "return_mean", "success")
"""Columns of ``metrics.csv`` that a pack without losses keeps."""

PACKED_FILES = (
    *(*RUN_FILES, METRICS, "evaluations.csv", FAILURE),
    "checkpoints/latest/meta.json",  # the step that training reached
)
"""Patterns of the files of a run that every pack holds."""

PART_FILES: dict[Part, tuple[str, ...]] = {
    "policies": POLICY_FILES,
    "episodes": ("evaluation/*/episodes.parquet",),
    "steps": ("evaluation/*/steps.parquet",),
    "films": ("evaluation/*/films/*",),
    "losses": (),  # in a file that every pack holds
}
"""Patterns of the files of a run that belong to a part."""


COMPRESSION = {"id": lzma.FILTER_LZMA2, "preset": 9}
WEIGHTS = {"lc": 0, "lp": 2, "pb": 2}
"""Options of xz for numbers of four bytes, which make up most of a pack with checkpoints."""
CHECKPOINT_FILES = ("checkpoints/latest/*",)
"""Patterns of the files with which a run resumes."""


def pack_study(
    out: Path,
    file: Path,
    *,
    leave_out: Collection[Part] = (),
    with_checkpoints: bool = False,
) -> int:
    """Write a study to one file; equal folders, equal bytes.

    Args:
        out: the study's folder.
        file: the pack.
        leave_out: parts that it lacks.
        with_checkpoints: add the latest checkpoint of each run that has not taken all its steps.

    Returns:
        Number of files in the pack, without its manifest.
    """
    for part in leave_out:
        if part not in PART_FILES:
            raise unknown_name("part of a pack", part, PART_FILES)
    if not file.name.endswith(SUFFIX):
        raise UserError(f"A pack is a {SUFFIX} file, got {file}.")
    if with_checkpoints and "losses" in leave_out:
        raise UserError(
            f"Runs resume with their whole {METRICS}: leave out losses or checkpoints."
        )
    study = open_study(out)
    patterns = list(PACKED_FILES)
    for part, part_files in PART_FILES.items():
        if part not in leave_out:
            patterns += part_files
    with lock_folder(
        out, remedy=f"Stop it before packing: {shell_command('study', 'stop', out)}"
    ):
        paths = [out / STUDY_FILE]
        for config in study.runs():
            folder = RunFolder(run_path(out, config))
            wanted = list(patterns)
            resumes = folder.has_checkpoint and not is_trained(folder, config)
            if with_checkpoints and resumes:
                wanted += CHECKPOINT_FILES
            for pattern in wanted:
                paths += sorted(folder.path.glob(pattern))
        contents = dict[str, bytes]()
        for path in filter(Path.is_file, paths):
            content = read_bytes(path)
            if path.name == METRICS and "losses" in leave_out:
                content = _reported_metrics(content)
            contents[path.relative_to(out).as_posix()] = content
    manifest = {
        "format": FORMAT,
        "study": study.name,
        "left_out": sorted(leave_out),
        "sha256": {name: digest(data) for name, data in contents.items()},
    }
    compression = COMPRESSION
    if any(fnmatch(name, "*/latest/*.safetensors") for name in contents):
        compression = COMPRESSION | WEIGHTS
    with (
        replacing(file) as temporary,
        lzma.open(temporary, "wb", filters=[compression]) as compressed,
        tarfile.open(
            fileobj=compressed, mode="w", format=tarfile.PAX_FORMAT
        ) as archive,
    ):
        text = json.dumps(manifest, indent=2) + "\n"
        members = {PACKED: text.encode(), **contents}
        for name, data in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    return len(contents)


def _reported_metrics(content: bytes) -> bytes:
    """Return a table of metrics with the columns that reports read."""
    rows = csv.DictReader(io.StringIO(content.decode()))
    columns = [name for name in REPORTED_METRICS if name in (rows.fieldnames or ())]
    text = io.StringIO()
    table = csv.DictWriter(text, columns, extrasaction="ignore", lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue().encode()


def unpack_study(file: Path, out: Path) -> Path:
    """Write the files of a pack to a new folder, and compare each with its digest.

    Packs of strangers are safe: only regular files of the manifest are written, inside the folder.

    Returns:
        ``out``, which `knowarm report` and `knowarm evaluate` read; runs resume whose checkpoint
        is in the pack.
    """
    if not file.name.endswith(SUFFIX):
        raise UserError(f"{file} is no pack of a study, whose name ends in {SUFFIX}.")
    if out.exists():
        raise UserError(
            f"{out} exists, and a pack is written to a new folder: give another one."
        )
    with (
        reading(file, "Give an intact pack of a study, or another folder."),
        new_folder(out) as temporary,
        lzma.open(file) as data,
        tarfile.open(fileobj=data, mode="r|") as archive,
    ):
        _extract(archive, temporary)
    return out


def _extract(archive: tarfile.TarFile, folder: Path) -> None:
    """Write the manifest and then the files that it lists.

    Raises:
        ValueError: the pack differs from its manifest.
    """
    digests = {}
    listed = {PACKED}
    for member in archive:
        name = member.name
        if (
            name not in listed
            or member.type != tarfile.REGTYPE
            or (folder / name).exists()
        ):
            raise ValueError(
                f"{name} is not one of the manifest's files, or no regular file"
            )
        archive.extract(member.replace(mtime=None), folder, filter="data")  # type: ignore[arg-type]
        if name == PACKED:
            digests = dict(json.loads(read_bytes(folder / PACKED))["sha256"])
            listed = set(digests)
    for name, expected in digests.items():
        file = folder / name
        if not file.is_file() or digest(read_bytes(file)) != expected:
            raise ValueError(f"{name} is missing or was changed")
    if not digests:
        raise ValueError(f"it has no {PACKED}, or an empty one")
