"""Recorded datasets: one page with the episodes, joints and questions of a LeRobotDataset v3."""

import io
from collections import Counter
from collections.abc import Iterator
from itertools import cycle, islice, repeat
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq
from markupsafe import Markup
from PIL import Image

from knowarm.arrays import Floats
from knowarm.errors import UserError
from knowarm.pictures import animation, data_uri
from knowarm.reading import read_json, reading
from knowarm.svg import drawing, element, path
from knowarm.world.viewing.record import write_html

INFO = "meta/info.json"
STATE = "observation.state"
REMEDY = "Record or download the dataset again."
WIDTH = 360  # of the drawing of joint angles [px]
HEIGHT = 120
LAST_MS = 1_500  # display time of a film's last image
OUTCOMES = {True: ", reached", False: ", failed", None: ""}
COLOURS = ("blue", "orange", "green", "purple", "teal", "pink", "gold", "brown")
"""Classes of the lines and marks of joints, in order."""


def is_dataset(folder: Path | str) -> bool:
    """Return whether a folder holds a dataset."""
    return (Path(folder) / INFO).is_file()


def write_dataset_page(folder: Path, page: Path, most: int) -> int:
    """Write an HTML page of the first ``most`` episodes; return how many these are.

    Raises:
        UserError: a file is damaged, or the images are no PNG files inside the Parquet files.
    """
    info = read_json(folder / INFO, remedy=REMEDY)
    with reading(folder / INFO, REMEDY):
        features = info["features"]
        images = [name for name in features if features[name]["dtype"] == "image"]
        joints = list(features[STATE]["names"])
        units = features[STATE].get("units") or list(repeat("", len(joints)))
        counts = (int(info["total_episodes"]), int(info["total_frames"]))
        pace_ms = round(1000 / float(info["fps"]))
    with reading(folder, REMEDY):  # whatever its files hold
        if not images:
            raise UserError(
                f"{folder} has no images in its Parquet files, only videos or none: record it by "
                "`knowarm record`."
            )
        columns = {images[0], STATE, "task_index", "episode_index"}
        tasks = _read(folder / "meta/tasks.parquet").to_pydict()
        texts = dict(zip(tasks["task_index"], tasks["task"], strict=True))
        episodes = list(islice(_episodes(folder, columns), most))
        if not episodes:
            raise UserError(f"{folder} holds no episodes. {REMEDY}")
        states = np.concatenate([np.array(frames[STATE]) for frames in episodes])
        low = states.min(axis=0)
        high = states.max(axis=0)
        ranges = list(zip(joints, units, low.tolist(), high.tolist(), strict=True))
        asked: Counter[str] = Counter()
        films = []
        for frames in episodes:
            question = texts[frames["task_index"][0]]
            asked[question] += 1
            film = [_image(cell["bytes"]) for cell in frames[images[0]]]
            angles = (np.array(frames[STATE]) - low) / np.maximum(high - low, 1e-9)
            films.append(
                {
                    "number": frames["episode_index"][0],
                    "question": question,
                    "outcome": OUTCOMES[frames.get("next.success", [None])[-1]],
                    "steps": len(film),
                    "film": data_uri("WEBP", animation(film, pace_ms, LAST_MS)),
                    "lines": Markup(_lines(angles)),
                }
            )
    write_html(
        page,
        "dataset.html.j2",
        title=f"Dataset {folder.resolve().name}",
        counts=counts,
        robot=info.get("robot_type"),
        asked=asked.items(),
        colours=COLOURS,
        joints=ranges,
        episodes=films,
    )
    return len(episodes)


def _episodes(folder: Path, columns: set[str]) -> Iterator[dict[str, list[Any]]]:
    """Yield the frames of each episode, a list per column."""
    for file in sorted(folder.glob("data/chunk-*/file-*.parquet")):
        frames = _read(file)
        missing = columns.difference(frames.column_names)
        if missing:
            raise ValueError(f"{file} lacks the columns {', '.join(missing)}")
        for number in frames["episode_index"].unique():
            yield frames.filter(pc.field("episode_index") == number).to_pydict()


def _read(file: Path) -> Any:
    with reading(file, REMEDY):
        return pq.read_table(file)


def _image(data: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))


def _lines(angles: Floats) -> str:
    """Draw angles (T, J), each 0 to 1 of its range, over the steps."""
    x = np.linspace(0, WIDTH, len(angles))
    lines = []
    for joint, colour in zip(angles.T, cycle(COLOURS), strict=False):
        points = np.stack([x, HEIGHT * (1 - joint)], 1).tolist()
        line = path(points, class_="line")
        lines.append(element("g", line, class_=f"c-{colour}"))
    return drawing(WIDTH, HEIGHT, "Joint angles over time", *lines)
