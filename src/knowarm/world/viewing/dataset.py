"""Recorded datasets: one page with the episodes, joints and questions of a LeRobotDataset v3."""

import io
from collections import Counter
from itertools import cycle, repeat
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from PIL import Image

from knowarm.arrays import Floats
from knowarm.errors import UserError
from knowarm.pictures import animation, data_uri
from knowarm.reading import read_json, reading
from knowarm.svg import drawing, element, escape, path
from knowarm.world.viewing.record import write_html

INFO = "meta/info.json"
STATE = "observation.state"
REMEDY = "Record or download the dataset again."
WIDTH = 360  # of the drawing of joint angles [px]
HEIGHT = 120
LAST_MS = 1_500  # display time of a film's last image
COLOURS = ("blue", "orange", "green", "purple", "teal", "pink", "gold", "brown")
"""Classes of the joints' lines, in order."""


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
        counts = f"{info['total_episodes']:,} episodes, {info['total_frames']:,} frames"
        pace = float(info["fps"])
    if not images:
        raise UserError(
            f"{folder} has no images in its Parquet files, only videos or none: record it by "
            "`knowarm record`."
        )
    tasks = _read(folder / "meta/tasks.parquet")
    texts = dict(zip(tasks["task_index"], tasks["task"], strict=True))
    episodes = _episodes(
        folder, [images[0], STATE, "task_index", "episode_index"], most
    )
    asked = Counter(texts[frames["task_index"][0]] for frames in episodes)
    body = [f"<p>{counts}, robot {escape(str(info.get('robot_type')))}.</p>"]
    body.append(
        _table(
            "Questions of the episodes below", ("question", "episodes"), asked.items()
        )
    )
    states = np.concatenate([np.array(frames[STATE]) for frames in episodes])
    low = states.min(axis=0)
    high = states.max(axis=0)
    ranges = zip(joints, units, low.tolist(), high.tolist(), strict=True)
    body.append(_table("Joints", ("joint", "unit", "smallest", "largest"), ranges))
    for frames in episodes:
        with reading(folder, REMEDY):
            film = [_image(cell["bytes"]) for cell in frames[images[0]]]
        moving = data_uri("WEBP", animation(film, round(1000 / pace), LAST_MS))
        angles = (np.array(frames[STATE]) - low) / np.maximum(high - low, 1e-9)
        caption = (
            f"Episode {frames['episode_index'][0]}: {texts[frames['task_index'][0]]}"
        )
        if "next.success" in frames:
            caption += ", reached" if frames["next.success"][-1] else ", failed"
        caption = escape(f"{caption}, after {len(film)} steps", quote=True)
        body.append(
            f'<figure><img src="{moving}" alt="{caption}" width="256"/>{_lines(angles)}'
            f"<figcaption>{caption}; joint angles over time, each in its own range"
            "</figcaption></figure>"
        )
    write_html(page, f"Dataset {folder.resolve().name}", "".join(body))
    return len(episodes)


def _episodes(
    folder: Path, columns: list[str], most: int
) -> list[dict[str, list[Any]]]:
    """Return columns of the first episodes, a list of frames each."""
    episodes: dict[int, dict[str, list[Any]]] = {}
    for file in sorted(folder.glob("data/chunk-*/file-*.parquet")):
        frames = _read(file)
        with reading(file, REMEDY):
            missing = [name for name in columns if name not in frames]
            if missing:
                raise ValueError(f"it lacks the columns {', '.join(missing)}")
        for row, number in enumerate(frames["episode_index"]):
            if number not in episodes and len(episodes) == most:
                return list(episodes.values())
            episode = episodes.setdefault(number, {name: [] for name in frames})
            for name, values in episode.items():
                values.append(frames[name][row])
    if not episodes:
        raise UserError(f"{folder} holds no episodes. {REMEDY}")
    return list(episodes.values())


def _read(file: Path) -> dict[str, list[Any]]:
    with reading(file, REMEDY):
        return pq.read_table(file).to_pydict()


def _image(data: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))


def _table(title: str, heads: tuple[str, ...], rows: Any) -> str:
    """Return a table; numbers have three decimals."""
    lines = ["".join(f"<th>{head}</th>" for head in heads)]
    for row in rows:
        cells = [
            f"{cell:.3f}" if isinstance(cell, float) else str(cell) for cell in row
        ]
        lines.append("".join(f"<td>{escape(cell)}</td>" for cell in cells))
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    table = f'<div class="scroll"><table>{body}</table></div>'
    return f'<div class="table-block"><h3>{title}</h3>{table}</div>'


def _lines(angles: Floats) -> str:
    """Draw angles (T, J), each 0 to 1 of its range, over the steps."""
    x = np.linspace(0, WIDTH, len(angles))
    lines = []
    for joint, colour in zip(angles.T, cycle(COLOURS), strict=False):
        points = np.stack([x, HEIGHT - joint * HEIGHT], 1).tolist()
        line = path([*map(tuple, points)], class_="line")
        lines.append(element("g", line, class_=f"c-{colour}"))
    return drawing(WIDTH, HEIGHT, "Joint angles over time", *lines)
