"""Tables and films of an evaluation: columns of episodes and steps, and how they are stored."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image, ImageSequence

from knowarm.experiment.measures import AGAIN
from knowarm.reading import reading, replacing

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

FURTHER_COLUMNS = {
    "chose_old_answer": ("bool", "whether it answered the query before the graph was edited"),
    "visible_answers": ("int64", "objects in the first image that answer, as the agent sees it"),
    "covered": ("bool", "whether the right object is among those that may answer"),
}
"""Further columns of some evaluations; tasks and probes add their own."""

STEP_COLUMNS = {
    "episode": ("int32", "index of the episode in the fixed list, from 0"),
    "step": ("int32", "step of the episode, from 1; the row holds the values after the step"),
    "distance_m": ("float32", "distance of gripper and grasp point [m]"),
    "angle_deg": ("float32", "geodesic angle between gripper and grasp frame [deg]"),
    "reward": ("float32", "reward of the step"),
}
"""Columns of ``steps.parquet``, followed by ``joint_<i>_rad`` and ``action_<i>`` per joint."""

FRAME_MS, LAST_MS = 120, 1_200
"""Display time of each image, and of the last before the animation repeats [ms]."""
MAX_FRAMES = 10_000
"""Most images of a film that is read; an episode has at most a few hundred steps."""


def episode_types(
    episodes: Mapping[str, np.ndarray], meanings: Mapping[str, str]
) -> dict[str, tuple[str, str]]:
    """Return type and meaning of the columns of ``episodes.parquet``.

    Args:
        episodes: the columns.
        meanings: of those that the task and the probes add.
    """
    known, kinds = EPISODE_COLUMNS | FURTHER_COLUMNS, {"b": "bool", "i": "int64", "f": "float64"}
    return {
        name: known.get(name)
        or (kinds.get(values.dtype.kind, "string"), meanings.get(name, "of the task"))
        for name, values in episodes.items()
    }


def step_columns(joints: int) -> dict[str, tuple[str, str]]:
    """Return the columns of ``steps.parquet`` for a robot with ``joints`` joints."""
    columns = dict(STEP_COLUMNS)
    for i in range(1, joints + 1):
        increment = f"chosen increment of joint {i}: 0..6, see ACTION_LEVELS"
        columns[f"joint_{i}_rad"] = ("float32", f"angle of joint {i} [rad]")
        columns[f"action_{i}"] = ("int8", increment)
    return columns


def write_table(
    path: Path, columns: Mapping[str, np.ndarray], described: Mapping[str, tuple[str, str]]
) -> None:
    """Write columns, (n,) each, to a Parquet file, with the meaning of each as metadata."""
    types = {"string": pa.dictionary(pa.int32(), pa.string())}
    fields = [
        pa.field(name, types.get(kind) or pa.type_for_alias(kind), metadata={"meaning": meaning})
        for name, (kind, meaning) in described.items()
    ]
    arrays = [pa.array(columns[f.name]).cast(f.type) for f in fields]
    table = pa.Table.from_arrays(arrays, schema=pa.schema(fields))
    with replacing(path) as temporary:
        pq.write_table(table, temporary, compression="zstd")


def read_table(path: Path) -> dict[str, np.ndarray]:
    """Read the columns of a Parquet file as (n,) arrays."""
    with reading(path, AGAIN):
        table = pq.read_table(pa.BufferReader(path.read_bytes()))
        return {name: np.asarray(table[name].to_numpy()) for name in table.column_names}


def write_film(path: Path, frames: np.ndarray) -> None:
    """Write images (T, H, W, 3) as a lossless animated WebP, which `read_film` reads."""
    images = [Image.fromarray(frame) for frame in frames]
    durations = [FRAME_MS] * (len(images) - 1) + [LAST_MS]
    options: dict[str, Any] = {"duration": durations, "loop": 0, "lossless": True, "method": 4}
    with replacing(path) as temporary:
        images[0].save(temporary, save_all=True, append_images=images[1:], **options)


def read_film(path: Path) -> np.ndarray:
    """Read the images of a film written by `write_film`: (T, H, W, 3) uint8."""
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
