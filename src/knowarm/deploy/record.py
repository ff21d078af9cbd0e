"""Recording of episodes as a LeRobotDataset v3: Parquet files with the images as PNG.

Readable by LeRobot and by plain PyArrow. Actions are joint targets; the discrete levels that led to
them stand beside. The state is stored for other learners: KnowArm's policies do not see it.
State and action are in the names and units of the robot's joint map.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from knowarm.deploy.joint_map import real_joints
from knowarm.deploy.runner import JointMap
from knowarm.errors import UserError
from knowarm.pictures import encode
from knowarm.reading import write_json, writing
from knowarm.world.agents.play import play_steps
from knowarm.world.agents.scripted import AgentProtocol
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.scene.compose import CONTROL_PERIOD_S
from knowarm.world.tasks.sampling import Episodes

VERSION = "v3.0"
IMAGE, CAMERAS = "observation.image", "observation.images."
STATE, ACTION, LEVELS = "observation.state", "action", "action.levels"
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
"""Quantiles of LeRobot's statistics, by their names there."""
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
EPISODES_PER_FILE = 500
"""Episodes per data file; about 50 MB of images of 64 x 64 pixels."""

_VECTORS = {STATE: "float32", ACTION: "float32", LEVELS: "int64"}
"""Columns of one number per joint, and their types."""
_SCALARS = {
    "next.reward": "float32",
    "next.done": "bool",
    "next.success": "bool",
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}


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
    writer = _Writer(env, folder, CAMERAS + camera if camera else IMAGE, joint_map)
    with writing(folder, "Give another folder."):
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise UserError(f"{folder} is not empty; give a new folder for the dataset.")
        return writer.write(agent, episodes)


class _Writer:
    """Writes a dataset file by file; only one file's frames are in memory."""

    def __init__(self, env: ArmVectorEnv, folder: Path, image: str, joint_map: Path | None) -> None:
        self.env, self.folder, self.image = env, folder, image
        joints, real = [*env.scene.joint_names], real_joints(env.scene, joint_map)
        self.joint_map = JointMap({"names": joints, "real": real})
        about = {f"{key}s": [joint[key] for joint in real] for key in ("name", "unit")}
        self.vectors = {STATE: about, ACTION: about, LEVELS: {"names": joints}}
        self.colours = np.zeros((3, 256), np.int64)
        self.tasks: dict[str, int] = {}
        self.rows: list[dict[str, Any]] = []
        self.frames, self.successes = 0, 0
        self.schema = self._schema()

    def write(self, agent: AgentProtocol, episodes: Episodes) -> int:
        """Play and write everything; return the number of successes."""
        count, pending, file = len(episodes), [], 0
        for first in range(0, count, self.env.num_envs):
            pending += self._play(agent, episodes[first : first + self.env.num_envs])
            while len(pending) >= EPISODES_PER_FILE:
                self._write_file(pending[:EPISODES_PER_FILE], file)
                pending, file = pending[EPISODES_PER_FILE:], file + 1
        if pending:
            self._write_file(pending, file)
        self._write_meta()
        return self.successes

    def _play(self, agent: AgentProtocol, chunk: Episodes) -> list[tuple[str, dict[str, Any]]]:
        """Play up to n episodes; return the text and the columns of each."""
        env = self.env
        rows: list[list[tuple[Any, ...]]] = [[] for _ in range(len(chunk))]
        texts, images, joints = [""], np.array([]), np.array([])
        for moment in play_steps(agent, env, chunk):
            if moment.actions is None:  # before the first step
                texts = [env.running.instruct(i) for i in range(len(chunk))]
            else:
                targets = self.joint_map.to_real(env.joint_targets)
                values = images, joints, targets, moment.actions, moment.reward
                for i in np.flatnonzero(moment.played):
                    success = bool(moment.infos["is_success"][i])
                    rows[i].append((*(each[i] for each in values), success))
            images, joints = moment.images, self.joint_map.to_real(env.joint_positions)
        names = (self.image, STATE, ACTION, LEVELS, "next.reward", "next.success")
        columns = (dict(zip(names, zip(*each, strict=True), strict=True)) for each in rows)
        return list(zip(texts, columns, strict=True))

    def _write_file(self, played: list[tuple[str, dict[str, Any]]], file: int) -> None:
        """Write the frames of some episodes to one data file, one row group per episode."""
        path = self.folder / DATA.format(chunk_index=0, file_index=file)
        path.parent.mkdir(parents=True, exist_ok=True)
        with pq.ParquetWriter(path, self.schema, compression="snappy") as writer:
            for text, columns in played:
                length, episode = len(columns[ACTION]), len(self.rows)
                task = self.tasks.setdefault(text, len(self.tasks))
                columns |= {
                    "next.done": np.arange(length) == length - 1,
                    "timestamp": np.arange(length) * CONTROL_PERIOD_S,
                    "frame_index": np.arange(length),
                    "episode_index": np.full(length, episode),
                    "index": self.frames + np.arange(length),
                    "task_index": np.full(length, task),
                }
                numbers = (*_VECTORS, *_SCALARS)
                arrays = {name: np.asarray(columns[name]).tolist() for name in numbers}
                images = columns[self.image]
                arrays[self.image] = [
                    {"bytes": encode(each, "PNG", compress_level=1), "path": None}
                    for each in images
                ]
                colours = count_colours(images)
                self.colours += colours
                stats = {name: statistics(columns[name]) for name in numbers}
                stats[self.image] = image_statistics(colours, length)
                writer.write_table(pa.table(arrays, schema=self.schema))
                self.rows.append(
                    {
                        "episode_index": episode,
                        "tasks": [text],
                        "length": length,
                        "data/chunk_index": 0,
                        "data/file_index": file,
                        "dataset_from_index": self.frames,
                        "dataset_to_index": self.frames + length,
                        "meta/episodes/chunk_index": 0,
                        "meta/episodes/file_index": 0,
                        **{
                            f"stats/{name}/{key}": value
                            for name in self.schema.names
                            for key, value in stats[name].items()
                        },
                    }
                )
                self.frames += length
                self.successes += bool(columns["next.success"][-1])

    def _schema(self) -> pa.Schema:
        """Return the columns, with the metadata by which Hugging Face's datasets decodes images."""
        fields = [pa.field(self.image, pa.struct({"bytes": pa.binary(), "path": pa.string()}))]
        features: dict[str, Any] = {self.image: {"_type": "Image"}}
        for name, kind in _VECTORS.items():
            length = len(self.vectors[name]["names"])
            fields.append(pa.field(name, pa.list_(pa.type_for_alias(kind), length)))
            item = {"dtype": kind, "_type": "Value"}
            features[name] = {"feature": item, "length": length, "_type": "List"}
        for name, kind in _SCALARS.items():
            fields.append(pa.field(name, pa.type_for_alias(kind)))
            features[name] = {"dtype": kind, "_type": "Value"}
        hints = {"huggingface": json.dumps({"info": {"features": features}})}
        return pa.schema(fields, metadata=hints)

    def _write_meta(self) -> None:
        size = self.env.config.image_size
        names = ["height", "width", "channels"]
        features: dict[str, Any] = {
            self.image: {"dtype": "image", "shape": [size, size, 3], "names": names}
        }
        for name, kind in _VECTORS.items():
            about = self.vectors[name]
            features[name] = {"dtype": kind, "shape": [len(about["names"])], **about}
        for name, kind in _SCALARS.items():
            features[name] = {"dtype": kind, "shape": [1], "names": None}
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
            "features": features,
        }
        path = self.folder / EPISODES
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.Table.from_pylist(self.rows), path)
        # The text is the index of the data frame that LeRobot reads.
        tasks = {"task_index": [*self.tasks.values()], "task": [*self.tasks]}
        kinds: dict[str, Any] = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
        pandas = {
            "index_columns": ["task"],
            "column_indexes": [],
            "columns": [
                {"name": name, "field_name": name, "pandas_type": kind}
                | {"numpy_type": numpy_kind, "metadata": None}
                for name, (kind, numpy_kind) in kinds.items()
            ],
        }
        table = pa.table(tasks).replace_schema_metadata({"pandas": json.dumps(pandas)})
        pq.write_table(table, self.folder / "meta/tasks.parquet")
        write_json(self.folder / "meta/stats.json", self._statistics())
        write_json(self.folder / "meta/info.json", info)

    def _statistics(self) -> dict[str, Any]:
        """Compute the statistics of the whole dataset from its files."""
        found = {self.image: image_statistics(self.colours, self.frames)}
        for name in (*_VECTORS, *_SCALARS):
            column = pq.read_table(self.folder / "data", columns=[name])[name].combine_chunks()
            values = column.flatten() if name in _VECTORS else column
            array = values.to_numpy(zero_copy_only=False).reshape(len(column), -1)
            found[name] = statistics(array)
        return found


def statistics(values: Any) -> dict[str, list[Any]]:
    """Compute a column's statistics per element as LeRobot names them."""
    array: NDArray[np.float64] = np.asarray(values, np.float64)
    array = array.reshape(len(array), -1)
    found = {key: getattr(array, key)(0).tolist() for key in ("min", "max", "mean", "std")}
    quantiles = np.quantile(array, [*QUANTILES.values()], 0).tolist()
    return found | dict(zip(QUANTILES, quantiles, strict=True)) | {"count": [len(array)]}


def count_colours(images: Any) -> NDArray[np.int64]:
    """Count the values 0 to 255 of each channel of images (n, H, W, 3), (3, 256)."""
    channels = np.asarray(images).reshape(-1, 3).T
    return np.stack([np.bincount(channel, minlength=256) for channel in channels])


def image_statistics(counts: NDArray[np.int64], frames: int) -> dict[str, list[Any]]:
    """Compute statistics per channel, (3, 1, 1), in 0..1, of the counts of `count_colours`."""
    levels, shares = np.arange(256) / 255, counts / counts.sum(1, keepdims=True)
    mean, below = shares @ levels, np.cumsum(shares, 1)
    found = {
        "min": levels[(counts > 0).argmax(1)],
        "max": levels[255 - (counts[:, ::-1] > 0).argmax(1)],
        "mean": mean,
        "std": np.sqrt(((levels - mean[:, None]) ** 2 * shares).sum(1)),
        **{key: levels[(below >= share).argmax(1)] for key, share in QUANTILES.items()},
    }
    shaped = {key: value.reshape(3, 1, 1).tolist() for key, value in found.items()}
    return shaped | {"count": [frames]}
