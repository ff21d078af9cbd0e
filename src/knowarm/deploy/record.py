"""Recording of episodes as a LeRobotDataset v3: Parquet files with the images as PNG.

Readable by LeRobot and by plain PyArrow. Actions are joint targets; the discrete levels that led to
them stand beside. The state is stored for other learners: KnowArm's policies do not see it.
State and action are in the names and units of the robot's joint map.
"""

import json
from collections import defaultdict
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from knowarm.arrays import Integers
from knowarm.deploy.joint_map import real_joints
from knowarm.deploy.runner import JointMap
from knowarm.errors import UserError
from knowarm.pictures import encode
from knowarm.reading import new_folder, write_json, writing
from knowarm.world.agents.play import play_steps
from knowarm.world.agents.scripted import AgentProtocol
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.scene.compose import CONTROL_PERIOD_S
from knowarm.world.tasks.sampling import Episodes

VERSION = "v3.0"
IMAGE = "observation.image"
CAMERAS = "observation.images."
STATE = "observation.state"
ACTION = "action"
LEVELS = "action.levels"
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
"""Quantiles of LeRobot's statistics, by their names there."""
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
EPISODES_PER_FILE = 500
"""Episodes per data file; about 50 MB of images of 64 x 64 pixels."""

_COLUMNS = {
    STATE: "float32",
    ACTION: "float32",
    LEVELS: "int64",
    "next.reward": "float32",
    "next.done": "bool",
    "next.success": "bool",
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""Types of all columns but the image; the first three hold a number per joint."""
TASKS_FRAME = (
    '{"index_columns": ["task"], "column_indexes": [], "columns": ['
    '{"name": "task_index", "field_name": "task_index", '
    '"pandas_type": "int64", "numpy_type": "int64", "metadata": null}, '
    '{"name": "task", "field_name": "task", '
    '"pandas_type": "unicode", "numpy_type": "object", "metadata": null}]}'
)
"""Data frame of the tasks that LeRobot reads: the text is its index."""

_Columns = dict[str, Any]
"""Values by the name of a column."""


def record(
    agent: AgentProtocol,
    env: ArmVectorEnv,
    episodes: Episodes,
    folder: Path,
    *,
    camera: str = "",
    joint_map: Path | None = None,
) -> int:
    """Play episodes and write them as a dataset; return how many succeeded.

    Args:
        agent: chooses the actions.
        env: plays several episodes at a time.
        episodes: what to play, N.
        folder: new or empty.
        camera: the images' column is ``observation.images.CAMERA``; empty: ``observation.image``.
        joint_map: TOML file whose table of that name replaces that of the robot.

    Raises:
        UserError: the folder holds something, or cannot be written to; the map does not fit.
    """
    image = CAMERAS + camera if camera else IMAGE
    with writing(folder, "Give another folder."):
        if folder.exists() and any(folder.iterdir()):
            raise UserError(
                f"{folder} is not empty; give a new folder for the dataset."
            )
        with new_folder(folder) as temporary:
            writer = _Writer(env, temporary, image, joint_map)
            return writer.write(agent, episodes)


class _Writer:
    """Writes a dataset file by file; only the images of one file are in memory."""

    def __init__(
        self, env: ArmVectorEnv, folder: Path, image: str, joint_map: Path | None
    ) -> None:
        self.env = env
        self.folder = folder
        self.image = image
        joints = list(env.scene.joint_names)
        real = real_joints(env.scene, joint_map)
        self.joint_map = JointMap({"names": joints, "real": real})
        about = {
            "names": [joint["name"] for joint in real],
            "units": [joint["unit"] for joint in real],
        }
        self.vectors = {STATE: about, ACTION: about, LEVELS: {"names": joints}}
        self.colours = np.zeros((3, 256), np.int64)
        self.tasks: dict[str, int] = {}
        self.rows: list[_Columns] = []
        self.numbers: dict[str, list[Any]] = defaultdict(list)
        self.frames = 0
        self.successes = 0
        self._describe_columns()

    def _describe_columns(self) -> None:
        """Make the schema, by whose metadata Hugging Face's datasets decodes images, and features.

        Features are LeRobot's description of the columns.
        """
        size = self.env.config.image_size
        image = pa.struct({"bytes": pa.binary(), "path": pa.string()})
        fields = [pa.field(self.image, image)]
        hints: _Columns = {self.image: {"_type": "Image"}}
        self.features: _Columns = {
            self.image: {
                "dtype": "image",
                "shape": [size, size, 3],
                "names": ["height", "width", "channels"],
            }
        }
        for name, kind in _COLUMNS.items():
            dtype = pa.type_for_alias(kind)
            hint: _Columns = {"dtype": kind, "_type": "Value"}
            about: _Columns = {"names": None}
            length = 1
            if name in self.vectors:
                about = self.vectors[name]
                length = len(about["names"])
                dtype = pa.list_(dtype, length)
                hint = {"feature": hint, "length": length, "_type": "List"}
            fields.append(pa.field(name, dtype))
            hints[name] = hint
            self.features[name] = {"dtype": kind, "shape": [length], **about}
        info = json.dumps({"info": {"features": hints}})
        self.schema = pa.schema(fields, metadata={"huggingface": info})

    def write(self, agent: AgentProtocol, episodes: Episodes) -> int:
        """Play and write everything, a row group per episode; return the number of successes."""
        played = self._play(agent, episodes)
        for file, _ in enumerate(range(0, len(episodes), EPISODES_PER_FILE)):
            path = self.folder / DATA.format(chunk_index=0, file_index=file)
            path.parent.mkdir(parents=True, exist_ok=True)
            with pq.ParquetWriter(path, self.schema, compression="snappy") as writer:
                for text, columns in islice(played, EPISODES_PER_FILE):
                    writer.write_table(self._add_episode(text, columns, file))
        self._write_meta()
        return self.successes

    def _play(
        self, agent: AgentProtocol, episodes: Episodes
    ) -> Iterator[tuple[str, _Columns]]:
        """Play episodes, n at a time; yield the text and the columns of each."""
        env = self.env
        for first in range(0, len(episodes), env.num_envs):
            chunk = episodes[first : first + env.num_envs]
            played: list[tuple[str, _Columns]] = []
            seen: _Columns = {}
            for moment in play_steps(agent, env, chunk):
                if moment.actions is None:  # before the first step
                    texts = map(env.running.instruct, range(len(chunk)))
                    played = [(text, defaultdict(list)) for text in texts]
                else:
                    frame = seen | {
                        ACTION: self.joint_map.to_real(env.joint_targets),
                        LEVELS: moment.actions,
                        "next.reward": moment.reward,
                        "next.success": moment.infos["is_success"],
                    }
                    for i in np.flatnonzero(moment.played):
                        _, columns = played[i]
                        for name, values in frame.items():
                            columns[name].append(values[i])
                seen = {
                    self.image: moment.images,
                    STATE: self.joint_map.to_real(env.joint_positions),
                }
            yield from played

    def _add_episode(self, text: str, columns: _Columns, file: int) -> pa.Table:
        """Return the frames of an episode, and count it."""
        number = len(self.rows)
        length = len(columns[ACTION])
        frames = np.arange(length)
        columns["next.done"] = frames == length - 1
        columns["timestamp"] = frames * CONTROL_PERIOD_S
        columns["frame_index"] = frames
        columns["episode_index"] = np.full(length, number)
        columns["index"] = self.frames + frames
        task = self.tasks.setdefault(text, len(self.tasks))
        columns["task_index"] = np.full(length, task)
        images = columns[self.image]
        files = [encode(image, "PNG", compress_level=1) for image in images]
        arrays: _Columns = {
            self.image: [{"bytes": data, "path": None} for data in files]
        }
        colours = count_colours(images)
        self.colours += colours
        row = {
            "episode_index": number,
            "tasks": [text],
            "length": length,
            "data/chunk_index": 0,
            "data/file_index": file,
            "dataset_from_index": self.frames,
            "dataset_to_index": self.frames + length,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        stats = {self.image: image_statistics(colours, length)}
        for name in _COLUMNS:
            values = np.asarray(columns[name])
            stats[name] = statistics(values)
            arrays[name] = values.tolist()
            self.numbers[name].append(values.astype(_COLUMNS[name]))
        for name, figures in stats.items():
            for key, figure in figures.items():
                row[f"stats/{name}/{key}"] = figure
        self.rows.append(row)
        self.frames += length
        self.successes += int(columns["next.success"][-1])
        return pa.table(arrays, schema=self.schema)

    def _write_meta(self) -> None:
        path = self.folder / EPISODES
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.Table.from_pylist(self.rows), path)
        tasks = pa.table({"task_index": [*self.tasks.values()], "task": [*self.tasks]})
        tasks = tasks.replace_schema_metadata({"pandas": TASKS_FRAME})
        pq.write_table(tasks, self.folder / "meta/tasks.parquet")
        stats = {self.image: image_statistics(self.colours, self.frames)}
        for name, episodes in self.numbers.items():
            stats[name] = statistics(np.concatenate(episodes))
        write_json(self.folder / "meta/stats.json", stats)
        info = {
            "codebase_version": VERSION,
            "robot_type": self.env.scene.robot.name,
            "total_episodes": len(self.rows),
            "total_frames": self.frames,
            "total_tasks": len(self.tasks),
            "chunks_size": 1000,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": round(1 / CONTROL_PERIOD_S),
            "splits": {"train": f"0:{len(self.rows)}"},
            "data_path": DATA,
            "video_path": None,
            "features": self.features,
        }
        write_json(self.folder / "meta/info.json", info)


def statistics(values: NDArray[Any]) -> _Columns:
    """Compute a column's statistics per element as LeRobot names them."""
    array = values.astype(np.float64).reshape(len(values), -1)
    figures = {
        "min": array.min(0),
        "max": array.max(0),
        "mean": array.mean(0),
        "std": array.std(0),
    }
    quantiles = np.quantile(array, [*QUANTILES.values()], 0)
    figures.update(zip(QUANTILES, quantiles, strict=True))
    stats = {key: figure.tolist() for key, figure in figures.items()}
    stats["count"] = [len(array)]
    return stats


def count_colours(images: Any) -> Integers:
    """Count the values 0 to 255 of each channel of images (n, H, W, 3), (3, 256)."""
    channels = np.asarray(images).reshape(-1, 3).T
    return np.stack([np.bincount(channel, minlength=256) for channel in channels])


def image_statistics(counts: Integers, frames: int) -> _Columns:
    """Compute statistics per channel, (3, 1, 1), in 0..1, of the counts of `count_colours`."""
    levels = np.arange(256) / 255
    shares = counts / counts.sum(1, keepdims=True)
    mean = shares @ levels
    below = np.cumsum(shares, 1)
    figures = {
        "min": levels[(counts > 0).argmax(1)],
        "max": levels[255 - (counts[:, ::-1] > 0).argmax(1)],
        "mean": mean,
        "std": np.sqrt(((levels - mean[:, None]) ** 2 * shares).sum(1)),
    }
    for key, share in QUANTILES.items():
        figures[key] = levels[(below >= share).argmax(1)]
    stats = {key: figure.reshape(3, 1, 1).tolist() for key, figure in figures.items()}
    stats["count"] = [frames]
    return stats
