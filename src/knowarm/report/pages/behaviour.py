"""Pages "Joints" and "Episodes": joint angles and films of the evaluated episodes."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from knowarm.errors import UserError
from knowarm.experiment.summary import read_film
from knowarm.knowledge.graph.terms import label_of
from knowarm.pictures import data_uri, encode
from knowarm.reading import read_bytes
from knowarm.report.blocks import (
    Block,
    Figure,
    Film,
    Films,
    Panel,
    Row,
    Verdict,
    table_of,
)
from knowarm.report.charts import density_chart
from knowarm.report.format import facet, signed
from knowarm.report.model import Evaluated, Evaluation, Group, TaskData
from knowarm.report.pages.paper import published_comparison

STRIP_FRAMES = 8  # frames of a film strip
MOST_EPISODES = 3  # shown per task: the first recorded one of each target
MOST_AGENTS = 4  # shown per task: subjects and baseline first
# Of the angles of a joint.
STATISTICS: dict[str, Callable[..., Any]] = {"mean": np.mean, "std": np.std}


def joint_blocks(task: TaskData) -> list[Block]:
    """Compare joint angles of the first subject and the baseline (paper, sections 5.1, 5.2)."""
    stored = list(filter(_has_steps, task.groups))
    compared = (*task.subjects[:1], task.baseline)
    pair = [group for group in compared if group in stored]
    if len(pair) < 2:
        pair = stored[:2]
    if len(pair) < 2:
        return []
    try:
        return [_joints(task, *pair)]
    except UserError as error:
        return [Verdict(str(error), tone="bad")]


def _has_steps(group: Group) -> bool:
    if group.best is None:
        return False
    return (group.best.folder / "steps.parquet").is_file()


def _joints(task: TaskData, first: Group, second: Group) -> Figure:
    evaluations = [group.best for group in (first, second) if group.best]
    one, other = map(Evaluation.joint_angles, evaluations)
    published = published_comparison(task, first, second).get("std_changes", {})
    colours = {first.name: first.colour, second.name: second.colour}
    names = dict(enumerate(evaluations[0].summary.joints, start=1))
    rows = []
    panels = []
    for joint in sorted(one.keys() & other.keys()):
        row: Row = {"joint": joint, "paper_std_change": published.get(str(joint))}
        title = f"joint {joint}"
        if joint in names:
            title += f" ({names[joint]})"
        for name, statistic in STATISTICS.items():
            after = float(statistic(one[joint]))
            before = float(statistic(other[joint]))
            row[f"first_{name}"] = after
            row[f"second_{name}"] = before
            row[f"{name}_change"] = after - before
        mean = signed(row["mean_change"])
        std = signed(row["std_change"])
        title += f": difference of means {mean}, of std {std}"
        rows.append(row)
        angles = {second.name: other[joint], first.name: one[joint]}
        name = f"Angles of joint {joint}"
        svg = density_chart(angles, colours, name, "angle [rad]")
        panels.append(Panel(svg, title))
    table = table_of(task, "joints", rows, first=first.name, second=second.name)
    return Figure(table, panels, legend=list(colours.items()))


def film_blocks(task: TaskData) -> list[Films]:
    """Show agents on the same episodes: the policy's images as a strip and as an animation."""
    first = (*task.subjects, task.baseline)
    groups = sorted(task.groups, key=lambda group: group not in first)
    filmed: dict[Evaluated, Evaluation] = {}
    for group in groups:
        best = group.best
        if best and best.films() and len(filmed) < MOST_AGENTS:
            filmed[group] = best
    for reference in task.references:
        (evaluation,) = reference.evaluations
        if evaluation.films():
            filmed[reference] = evaluation
    if not filmed:
        return []
    films = map(Evaluation.films, filmed.values())
    common = set.intersection(*map(set, films))
    blocks = []
    with suppress(UserError):
        first_filmed = next(iter(filmed.values()))
        for number, words in _first_of_each_target(first_filmed, sorted(common)):
            shown = [_film(agent, best, number) for agent, best in filmed.items()]
            blocks.append(Films(f"Episode {number}, {words}", shown))
    return blocks


def _first_of_each_target(
    evaluation: Evaluation, numbers: list[int]
) -> list[tuple[int, str]]:
    """Return the number of the first episode of each target, with its object and query."""
    episodes = evaluation.episodes()
    first = {}
    for number in reversed(numbers):
        first[episodes["target"][number]] = number
    described = []
    for number in sorted(first.values())[:MOST_EPISODES]:
        words = facet(str(episodes["facet"][number]))
        if "query" in episodes:
            query = query_words(str(episodes["query"][number]))
            words = f"asked for \u201c{query}\u201d ({words})"
        described.append((number, words))
    return described


def query_words(text: str) -> str:
    """Return a query in words: "hasColor light_blue" as "has color light blue"."""
    return " ".join(label_of(word, {}) for word in text.split(" "))


def _film(agent: Evaluated, evaluation: Evaluation, number: int) -> Film:
    episodes = evaluation.episodes()
    path = evaluation.films()[number]
    frames = read_film(path)
    last = len(frames) - 1
    places = np.linspace(0, last, min(STRIP_FRAMES, len(frames))).round().astype(int)
    height, width = frames.shape[1:3]
    return Film(
        agent.name,
        strip=[(_png(frames[step]), f"step {step}") for step in places.tolist()],
        moving=data_uri("WEBP", read_bytes(path)),
        poster=_png(frames[last]),
        size=(width, height),
        episode={name: values[number] for name, values in episodes.items()},
        colour=agent.colour,
    )


def _png(image: np.ndarray) -> str:
    return data_uri("PNG", encode(image, "PNG", optimize=True))
