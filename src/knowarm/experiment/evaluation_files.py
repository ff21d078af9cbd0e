"""Columns of an evaluation go in; Parquet files that describe themselves come out, and back."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from knowarm.errors import UserError

EPISODE_COLUMNS = {
    "episode": ("int32", "number of the episode in the fixed list, from 0"),
    "evaluation_seed": ("int64", "seed the episode was drawn from"),
    "target": ("string", "object to be reached"),
    "facet": ("string", "object and colour, as object/colour"),
    "return": ("float64", "sum of the rewards, not discounted"),
    "length": ("int32", "steps until success or the time limit"),
    "distance_m": ("float64", "gripper to grasp point at the end [m]"),
    "angle_deg": ("float64", "geodesic angle between gripper and grasp frame at the end [deg]"),
    "success": ("bool", "distance and angle within the thresholds at once"),
    "accurate": ("bool", "distance within the threshold at the end: the paper's accuracy"),
    "success_wide": ("bool", "distance and the wider angle threshold were met at some step"),
}
"""Columns of ``episodes.parquet``: type and meaning; one row an episode."""

STEP_COLUMNS = {
    "episode": ("int32", "number of the episode in the fixed list, from 0"),
    "step": ("int32", "step of the episode, from 1; values are those after the step"),
    "distance_m": ("float32", "gripper to grasp point [m]"),
    "angle_deg": ("float32", "geodesic angle between gripper and grasp frame [deg]"),
    "reward": ("float32", "reward of the step"),
}
"""Columns of ``steps.parquet`` beside a pair ``joint_<i>_rad``, ``action_<i>`` for each joint."""


def step_columns(joints: int) -> dict[str, tuple[str, str]]:
    """Columns of ``steps.parquet`` for a robot of so many joints."""
    columns = dict(STEP_COLUMNS)
    for i in range(1, joints + 1):
        columns[f"joint_{i}_rad"] = ("float32", f"angle of joint {i} [rad]")
        columns[f"action_{i}"] = (
            "int8",
            f"increment chosen for joint {i}: 0..6, see ACTION_LEVELS",
        )
    return columns


def write_table(
    path: Path, columns: Mapping[str, np.ndarray], described: Mapping[str, tuple[str, str]]
) -> None:
    """Write columns to Parquet; each column carries its meaning and unit as metadata.

    Args:
        path: the file.
        columns: one (n,) array each, for every name in ``described``.
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
    """Columns of a Parquet file as arrays.

    Args:
        path: the file.
        names: the columns to read; all of them when None.

    Raises:
        UserError: the file is missing, damaged, or lacks a column.
    """
    try:
        table = pq.read_table(path, columns=names)
    except (OSError, pa.ArrowException) as error:
        reason = str(error).splitlines()[0]
        raise UserError(f"Cannot read {path}: {reason}. Evaluate the run again.") from error
    missing = set(names or ()) - set(table.column_names)
    if missing:
        raise UserError(f"{path} lacks the column {min(missing)!r}. Evaluate the run again.")
    return {name: np.asarray(table[name].to_numpy()) for name in table.column_names}
