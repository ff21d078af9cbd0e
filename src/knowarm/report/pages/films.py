"""Films of evaluated episodes go in; strips of several agents on the same episode come out."""

import base64
import io
from pathlib import Path

import numpy as np
from PIL import Image

from knowarm.errors import UserError
from knowarm.experiment.evaluation_files import read_film
from knowarm.report.blocks import Film, Films, Page
from knowarm.report.palette import colours
from knowarm.report.study import Judged, Study, Task

IMAGES = 8
"""Images of a strip."""

MOST_EPISODES = 3
"""Episodes shown of a task: the first of each target among those filmed."""

MOST_AGENTS = 4
"""Agents shown of a task: the paper's first."""


def films_page(study: Study) -> Page:
    """The agents on the same episodes: what the policy saw, in steps and moving."""
    page = Page(
        name="films",
        short="Episodes",
        title="Episodes",
        lead="Agents on the same episode, as the policy saw it. Press play to watch.",
    )
    for task in study.tasks:
        page.add(task, _task_films(task))
    return page


def _task_films(task: Task) -> list[Films]:
    chosen = colours(group.name for group in task.groups)
    players: list[tuple[str, str, Judged]] = []
    for group in task.groups:
        run = group.best_run()
        if run and group.label and run.judged[group.label].films():
            players.append((group.name, chosen[group.name], run.judged[group.label]))
    players = sorted(players, key=lambda each: each[0] not in ("full", "bm"))[:MOST_AGENTS]
    for each in task.references:
        if each.judged.films():
            players.append((each.name, "c-faint", each.judged))
    if not players:
        return []
    common = set.intersection(*(set(judged.films()) for _, _, judged in players))
    blocks = []
    try:
        for number, target in _first_of_each_target(players[0][2], sorted(common)):
            films = [_film(name, colour, judged, number) for name, colour, judged in players]
            words = target.replace("_", " ").replace("/", ", ")
            title = f"Episode {number}, {words}: {task.title}"
            blocks.append(Films(title=title, films=films))
    except UserError:
        return blocks
    return blocks


def _first_of_each_target(judged: Judged, numbers: list[int]) -> list[tuple[int, str]]:
    episodes = judged.episodes()
    found: dict[str, tuple[int, str]] = {}
    for number in numbers:
        target = str(episodes["target"][number])
        found.setdefault(target, (number, str(episodes["facet"][number])))
    return sorted(found.values())[:MOST_EPISODES]


def _film(name: str, colour: str, judged: Judged, number: int) -> Film:
    path = judged.films()[number]
    frames = read_film(path)
    episodes = judged.episodes()
    length = int(episodes["length"][number])
    reached = bool(episodes["success"][number])
    ending = (f"reached after {length} steps" if reached else f"not reached in {length} steps") + (
        f", {episodes['distance_m'][number] * 100:.1f} cm and "
        f"{episodes['angle_deg'][number]:.0f}° off at the end"
    )
    places = np.unique(np.linspace(0, len(frames) - 1, min(IMAGES, len(frames))).round())
    strip = [(_png(frames[int(i)]), f"step {int(i)}") for i in places]
    height, width = frames.shape[1:3]
    return Film(
        name=name,
        colour=colour,
        strip=strip,
        moving=_data_uri("image/webp", path),
        poster=_png(frames[-1]),
        size=(width, height),
        text=ending,
    )


def _png(image: np.ndarray) -> str:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "PNG", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"


def _data_uri(kind: str, path: Path) -> str:
    return f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode()}"
