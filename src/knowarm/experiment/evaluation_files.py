"""Files of an evaluation: Parquet tables of episodes and steps, and animations of episodes."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image, ImageSequence

from knowarm.errors import UserError
from knowarm.reading import reading

EPISODE_COLUMNS = {
    "episode": ("int32", "index of the episode in the fixed list, from 0"),
    "evaluation_seed": ("int64", "seed from which the episode was drawn"),
    "target": ("string", "target object"),
    "facet": ("string", "object and colour, as object/colour"),
    "return": ("float64", "sum of the rewards, not discounted"),
    "length": ("int32", "steps until success or the time limit"),
    "distance_m": ("float64", "distance of gripper and grasp point at the end [m]"),
    "angle_deg": ("float64", "geodesic angle between gripper and grasp frame at the end [deg]"),
    "success": ("bool", "distance and angle within the thresholds at the same step"),
    "accurate": ("bool", "distance within the threshold at the end: the paper's accuracy"),
    "success_wide": ("bool", "distance and the wider angle threshold met at some step"),
}
"""Columns of ``episodes.parquet``: type and meaning; one row per episode."""

CHOICE_COLUMNS = {
    "query": ("string", "what the episode asked for"),
    "chosen": ("string", "object whose grasp point was nearest to the gripper at the end"),
    "choice_correct": ("bool", "whether that is the object that the query means"),
    "chose_old_answer": ("bool", "whether the query meant it before the graph was edited"),
}
"""Further columns where several objects are visible."""

STEP_COLUMNS = {
    "episode": ("int32", "index of the episode in the fixed list, from 0"),
    "step": ("int32", "step of the episode, from 1; the row holds the values after the step"),
    "distance_m": ("float32", "distance of gripper and grasp point [m]"),
    "angle_deg": ("float32", "geodesic angle between gripper and grasp frame [deg]"),
    "reward": ("float32", "reward of the step"),
}
"""Columns of ``steps.parquet``, followed by ``joint_<i>_rad`` and ``action_<i>`` per joint."""

FRAME_MS = 120
"""Display time of each image [ms]."""

MAX_FRAMES = 10_000
"""Most images of a film that is read; an episode has at most a few hundred steps."""

AGAIN = "Evaluate the run again."
"""Remedy for a damaged file of an evaluation."""

LAST_MS = 1_200
"""Display time of the last image before the animation repeats [ms]."""


def step_columns(joints: int) -> dict[str, tuple[str, str]]:
    """Return the columns of ``steps.parquet`` for a robot with ``joints`` joints."""
    columns = dict(STEP_COLUMNS)
    for i in range(1, joints + 1):
        columns[f"joint_{i}_rad"] = ("float32", f"angle of joint {i} [rad]")
        columns[f"action_{i}"] = (
            "int8",
            f"chosen increment of joint {i}: 0..6, see ACTION_LEVELS",
        )
    return columns


def write_table(
    path: Path, columns: Mapping[str, np.ndarray], described: Mapping[str, tuple[str, str]]
) -> None:
    """Write columns to a Parquet file, with the meaning and unit of each as its metadata.

    Args:
        path: the file.
        columns: one (n,) array for every name in ``described``.
        described: type and meaning of each column.

    Raises:
        UserError: the file cannot be written.
    """
    types = {"string": pa.dictionary(pa.int32(), pa.string())}
    fields = [
        pa.field(name, types.get(kind) or pa.type_for_alias(kind), metadata={"meaning": meaning})
        for name, (kind, meaning) in described.items()
    ]
    arrays = [pa.array(columns[f.name]).cast(f.type) for f in fields]
    temporary = path.with_name(path.name + ".tmp")
    try:
        pq.write_table(
            pa.Table.from_arrays(arrays, schema=pa.schema(fields)), temporary, compression="zstd"
        )
        temporary.replace(path)
    except OSError as error:
        raise UserError(f"Cannot write {path}: {error.strerror or error}.") from error


def read_table(path: Path, names: list[str] | None = None) -> dict[str, np.ndarray]:
    """Read columns of a Parquet file as (n,) arrays.

    Args:
        path: the file.
        names: the columns to read; None reads all.

    Raises:
        UserError: the file is missing, damaged, or lacks a column.
    """
    with reading(path, AGAIN):
        table = pq.read_table(pa.BufferReader(path.read_bytes()), columns=names)
        missing = set(names or ()) - set(table.column_names)
        if missing:
            raise UserError(f"{path} lacks the column {min(missing)!r}. {AGAIN}")
        return {name: np.asarray(table[name].to_numpy()) for name in table.column_names}


def write_film(path: Path, frames: np.ndarray) -> None:
    """Write a lossless animated WebP, which browsers play and `read_film` reads back exactly.

    Args:
        path: the file; its folder is created.
        frames: (T, H, W, 3) uint8, T at least 1.

    Raises:
        UserError: the file cannot be written.
    """
    images = [Image.fromarray(frame) for frame in frames]
    durations = [FRAME_MS] * (len(images) - 1) + [LAST_MS]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        images[0].save(
            path,
            save_all=True,
            append_images=images[1:],
            duration=durations,
            loop=0,
            lossless=True,
            method=4,
        )
    except OSError as error:
        raise UserError(f"Cannot write {path}: {error.strerror or error}.") from error


def read_film(path: Path) -> np.ndarray:
    """Read the images of a film written by `write_film`: (T, H, W, 3) uint8.

    Raises:
        UserError: the file is missing or not an image.
    """
    frames: list[np.ndarray] = []
    with reading(path, AGAIN):
        with Image.open(path) as film:
            for number, frame in enumerate(ImageSequence.Iterator(film)):
                image = np.asarray(frame.convert("RGB"))
                # The encoder stores equal neighbours once, with the sum of their times.
                shown = int(frame.info.get("duration", 0))  # a single image has none
                is_last = number == getattr(film, "n_frames", 1) - 1
                extra = shown - (LAST_MS if is_last else FRAME_MS)
                frames += [image] * (1 + max(0, extra) // FRAME_MS)
                if len(frames) > MAX_FRAMES:
                    raise ValueError(f"it shows more than {MAX_FRAMES:,} images")
        return np.stack(frames)
