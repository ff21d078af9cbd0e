"""What an evaluation measured: its measures and summary, its tables and films, as stored."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image, ImageSequence

from knowarm.config import check_values, from_dict
from knowarm.errors import UserError
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.fence import fenced
from knowarm.measures import Columns, Measure
from knowarm.reading import read_json, read_toml, reading, replacing
from knowarm.statistics import Interval, bootstrap, share_of
from knowarm.world.tasks import task_measures

AGAIN = "Evaluate the run again."
"""Remedy for a damaged file of an evaluation."""
WIDE_ANGLE_DEG = 20.0
"""Largest angle of ``success_wide`` [deg], unless that of ``success`` is larger."""

Number = float | Interval
Numbers = dict[str, Number]
Described = Mapping[str, tuple[str, str]]
"""Type and meaning of columns, by name."""

MEASURED = read_toml(Path(__file__).with_name("evaluation.toml"))
"""Columns, with type and meaning, and measures of evaluations."""

STATISTICS: dict[str, Callable[[np.ndarray], Number]] = {
    "share": share_of,
    "mean": partial(bootstrap, repetitions=2_000),
    "average": np.mean,
    "std": lambda values: np.std(values, ddof=1) if len(values) > 1 else 0.0,
    "max": np.max,
    "count": len,
}


def _choice_corrected(episodes: Columns) -> Interval | None:
    """Return the share of right choices: 0 for a choice at random, 1 if all are right.

    None: there is no choice, since an episode shows one object.
    """
    choice = share_of(episodes["choice_correct"])
    chance = episodes["chance"][0]
    if chance == 1:
        return None
    ends = (choice.estimate, choice.low, choice.high)
    return Interval(*(float((end - chance) / (1 - chance)) for end in ends))


def _success_corrected(episodes: Columns) -> float | None:
    """Return the success; 0 for an agent that reaches as often what it chooses at random.

    None: there is no choice.
    """
    success = episodes["success"]
    right = episodes["choice_correct"]
    chance = episodes["chance"][0]
    if chance == 1:
        return None
    guessed = chance * (success[right].mean() if right.any() else 0.0)
    return float((success.mean() - guessed) / (1 - chance))


def _switched(episodes: Columns) -> Interval | None:
    """Return the share of the new answer among the episodes that ended at the new or the old."""
    right = episodes["choice_correct"]
    either = right | episodes["chose_old_answer"]
    return share_of(right[either]) if either.any() else None


def _saw_several(episodes: Columns) -> Interval:
    """Return the share of first images in which an agent sees more than one answer."""
    return share_of(episodes["visible_answers"] > 1)


def _asks(episodes: Columns) -> Interval:
    """Return the share of first images in which an agent sees not exactly one candidate."""
    return share_of(episodes["visible_answers"] != 1)


def _failure_distance(statistic: str, episodes: Columns) -> Number | None:
    """Return a statistic of the final distance of the episodes that failed."""
    distances = episodes["distance_m"][~episodes["success"]]
    return STATISTICS[statistic](distances) if len(distances) else None


COMPUTED: dict[str, Callable[[Columns], Any]] = {
    "failure_distance_mean": partial(_failure_distance, "average"),
    "failure_distance_std": partial(_failure_distance, "std"),
    "failure_distance_max": partial(_failure_distance, "max"),
    "choice_corrected": _choice_corrected,
    "success_corrected": _success_corrected,
    "switched": _switched,
    "saw_several_answers": _saw_several,
    "questions": _asks,
}
"""What computes a measure that is no statistic of a column."""
MEASURES: list[Measure] = []
for _name, _fields in MEASURED["measures"].items():
    MEASURES.append(Measure(_name, compute=COMPUTED.get(_name), **_fields))
"""Measures of every evaluation, in the order in which they are stored and shown."""
OF_QUERIES = ("episodes", "success", "choice")
"""Measures that are stored for every single query, of which there may be hundreds."""


def find_measure(name: str) -> Measure | None:
    """Return a measure of every evaluation or of a task by its name, or None."""
    for candidate in (*MEASURES, *task_measures()):
        if candidate.name == name:
            return candidate
    return None


def measure(name: str) -> Measure:
    """Return a measure by its name; one of a task that is not registered has no better title."""
    return find_measure(name) or Measure(name, name.replace("_", " "))


GROUPS = ("target", "facet", "query_type", "query", "fact_kind")
"""Columns by whose values episodes are grouped, where they have them."""


def summarize(
    episodes: Columns, measures: Sequence[Measure] = ()
) -> tuple[Numbers, dict[str, dict[str, Numbers]]]:
    """Compute ``numbers`` and ``groups`` of a summary from the columns of the episodes.

    Args:
        episodes: the columns.
        measures: those of the task and of the probes.
    """
    measures = [*MEASURES, *measures]
    of_queries = [measure for measure in measures if measure.name in OF_QUERIES]
    groups: dict[str, dict[str, Numbers]] = {}
    for group in GROUPS:
        if group not in episodes:
            continue
        groups[group] = {}
        for value in np.unique(episodes[group]):
            has_value = episodes[group] == value
            members = {name: column[has_value] for name, column in episodes.items()}
            stored = of_queries if group == "query" else measures
            groups[group][str(value)] = _numbers(members, stored)
    return _numbers(episodes, measures), groups


def _numbers(episodes: Columns, measures: Sequence[Measure]) -> Numbers:
    numbers: Numbers = {}
    for measure in measures:
        number = _compute(measure, episodes)
        if isinstance(number, Interval):
            numbers[measure.name] = number
        elif number is not None:
            numbers[measure.name] = float(number)
    return numbers


def _compute(measure: Measure, episodes: Columns) -> Number | None:
    """Return a measure of some episodes; None if they lack its column, or none counts."""
    if measure.column not in episodes:
        return None
    if measure.compute is not None:
        return measure.compute(episodes)
    values = episodes[measure.column]
    if measure.equals is not None:
        values = values == measure.equals
    if isinstance(measure.among, str):
        values = values[episodes[measure.among]]
    elif measure.among is not None:
        values = values[measure.among(episodes)]
    return STATISTICS[measure.statistic](values) if len(values) else None


FORMAT = 2
"""Version of the evaluation folder's layout."""
NEEDED = ("episodes", "success", "accuracy", "return_mean")
"""Measures without which there is no evaluation."""


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Settings and numbers of an evaluation: the content of ``summary.json``.

    ``summary["success"]`` is a number of all episodes.
    """

    format: int = FORMAT
    """Version of the layout."""
    agent: str
    """The agent, as ``experiment/seed``."""
    label: str
    """Name of the evaluation's folder."""
    config: EvaluationConfig
    """Episodes, thresholds and test conditions."""
    env: Mapping[str, Any]
    """Configuration of the environment that was played."""
    joints: tuple[str, ...] = ()
    """Names of the joints, in the order of their columns in ``steps.parquet``."""
    numbers: Numbers
    """Numbers of all episodes by the name of their measure."""
    groups: Mapping[str, Mapping[str, Numbers]]
    """Numbers of the episodes with each value of `GROUPS`; those of ``blind`` agents by name."""

    def __post_init__(self) -> None:
        check_values(self.numbers, where="numbers")
        check_values(self.groups, where="groups")
        missing = [name for name in NEEDED if name not in self.numbers]
        if missing:
            raise UserError(
                f"numbers of the summary {self.label} lack {', '.join(missing)}."
            )

    def __getitem__(self, name: str) -> float:
        """Return a number of all episodes, without its interval."""
        return self.interval(name).estimate

    def __contains__(self, name: str) -> bool:
        """Tell whether a number of all episodes is known."""
        return name in self.numbers

    def of(self, group: str = "", value: str = "") -> Numbers:
        """Return the numbers of all episodes, or of those with a value of `GROUPS`, if any."""
        if not group:
            return self.numbers
        return self.groups.get(group, {}).get(value, {})

    def interval(self, name: str, group: str = "", value: str = "") -> Interval:
        """Return a number with its interval over episodes, of no width if it has none."""
        number = self.of(group, value)[name]
        if isinstance(number, Interval):
            return number
        return Interval(number, number, number)

    @classmethod
    def read(cls, folder: Path, *, with_groups: bool = True) -> "Summary":
        """Read the summary of an evaluation's folder, or all but its groups, most of the file."""
        path = folder / "summary.json"
        values = read_json(path, remedy=AGAIN)
        with reading(path, AGAIN):
            version = values.get("format")
            if version != FORMAT:
                raise ValueError(f"format {version!r}, this version reads {FORMAT}")
            if not with_groups:
                values["groups"] = {}
            return from_dict(cls, values)


EPISODE_COLUMNS: Described = MEASURED["columns"]["episodes"]
"""Columns of ``episodes.parquet``: type and meaning; one row per episode."""
STEP_COLUMNS: Described = MEASURED["columns"]["steps"]
"""Columns of ``steps.parquet``, followed by ``joint_<i>_rad`` and ``action_<i>`` per joint."""

FRAME_MS = 120
"""Display time of each image of a film [ms]."""
LAST_MS = 1_200
"""Display time of the last image, before the animation repeats [ms]."""
MAX_FRAMES = 10_000
"""Most images of a film that is read; an episode has at most a few hundred steps."""


def episode_types(episodes: Columns, meanings: Mapping[str, str]) -> Described:
    """Return type and meaning of the columns of ``episodes.parquet``.

    Args:
        episodes: the columns.
        meanings: of those that the task and the probes add.
    """
    known = MEASURED["columns"]["episodes"] | MEASURED["columns"]["further"]
    kinds = {"b": "bool", "i": "int64", "f": "float64"}
    types = {}
    for name, values in episodes.items():
        kind = kinds.get(values.dtype.kind, "string")
        types[name] = known.get(name, (kind, meanings.get(name, "of the task")))
    return types


def step_columns(joints: int) -> Described:
    """Return the columns of ``steps.parquet`` for a robot with ``joints`` joints."""
    columns = dict(STEP_COLUMNS)
    for i in range(1, joints + 1):
        increment = f"chosen increment of joint {i}: 0..6, see ACTION_LEVELS"
        columns[f"joint_{i}_rad"] = ("float32", f"angle of joint {i} [rad]")
        columns[f"action_{i}"] = ("int8", increment)
    return columns


def write_table(path: Path, columns: Columns, described: Described) -> None:
    """Write columns, (n,) each, to a Parquet file, with the meaning of each as metadata."""
    fields = []
    arrays = []
    for name, (kind, meaning) in described.items():
        arrow = pa.type_for_alias(kind)
        if kind == "string":
            arrow = pa.dictionary(pa.int32(), arrow)
        fields.append(pa.field(name, arrow, metadata={"meaning": meaning}))
        arrays.append(pa.array(columns[name]).cast(arrow))
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
    durations = [FRAME_MS for _ in images]
    durations[-1] = LAST_MS
    with replacing(path) as temporary:
        images[0].save(
            temporary,
            save_all=True,
            append_images=images[1:],
            duration=durations,
            loop=0,
            lossless=True,
            method=4,
        )


def read_film(path: Path) -> np.ndarray:
    """Read the images of a film written by `write_film`: (T, H, W, 3) uint8."""
    with reading(path, AGAIN):
        return fenced(_decode_film, path)


def _decode_film(path: Path) -> np.ndarray:
    frames: list[np.ndarray] = []
    with Image.open(path) as film:
        for number, frame in enumerate(ImageSequence.Iterator(film)):
            image = np.asarray(frame.convert("RGB"))
            # The encoder stores equal neighbours once, with the sum of their times.
            shown_ms = int(frame.info.get("duration", 0))  # a single image has none
            is_last = number == getattr(film, "n_frames", 1) - 1
            extra_ms = shown_ms - (LAST_MS if is_last else FRAME_MS)
            frames.extend(repeat(image, 1 + max(0, extra_ms) // FRAME_MS))
            if len(frames) > MAX_FRAMES:
                raise ValueError(f"it shows more than {MAX_FRAMES:,} images")
    return np.stack(frames)
