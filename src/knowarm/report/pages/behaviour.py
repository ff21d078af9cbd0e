"""Pages "Joints" and "Episodes": joint angles and films of the evaluated episodes."""

from contextlib import suppress

import numpy as np

from knowarm.errors import UserError
from knowarm.experiment.summary import read_film
from knowarm.knowledge.graph.terms import label_of
from knowarm.pictures import data_uri, encode
from knowarm.report import format
from knowarm.report.blocks import Block, Column, Figure, Film, Films, Panel, Row, Verdict, table_of
from knowarm.report.charts import density_chart
from knowarm.report.model import Evaluation, Group, TaskData
from knowarm.report.pages.paper import published_comparison

STRIP_FRAMES = 8  # frames of a film strip
MOST_EPISODES = 3  # shown per task: the first recorded one of each target
MOST_AGENTS = 4  # shown per task: subjects and baseline first


def joint_blocks(task: TaskData) -> list[Block]:
    """Compare joint angles of the first subject and the baseline (paper, sections 5.1, 5.2)."""
    best = {group: group.best.folder for group in task.groups if group.best}
    stored = [group for group, folder in best.items() if (folder / "steps.parquet").is_file()]
    wanted = [group for group in (*task.subjects[:1], task.baseline) if group in stored]
    pair = wanted if len(wanted) == 2 else stored
    if len(pair) < 2:
        return []
    try:
        return [_joints(task, *pair[:2])]
    except UserError as error:
        return [Verdict(sentence=str(error), tone="bad")]


def _joints(task: TaskData, first: Group, second: Group) -> Figure:
    evaluations = [group.best for group in (first, second) if group.best]
    one, other = (evaluation.joint_angles() for evaluation in evaluations)
    published = published_comparison(task, first, second).get("std_changes", {})
    names = dict(enumerate(evaluations[0].summary.joints, start=1))
    rows: list[Row] = []
    panels = []
    for joint in [joint for joint in one if joint in other]:
        row: Row = {"joint": joint}
        for key, statistic in (("mean", np.mean), ("std", np.std)):
            values = [float(statistic(each[joint])) for each in (one, other)]
            row |= {f"first_{key}": values[0], f"second_{key}": values[1]}
            row[f"{key}_change"] = values[0] - values[1]
        rows.append(row | {"paper_std_change": published.get(str(joint))})
        shown = {second.name: other[joint], first.name: one[joint]}
        svg = density_chart(shown, task.colours, f"Angles of joint {joint}", "angle [rad]")
        mean, std = (format.signed(row[f"{key}_change"]) for key in ("mean", "std"))
        named = f"joint {joint} ({names[joint]})" if joint in names else f"joint {joint}"
        title = f"{named}: difference of means {mean}, of std {std}"
        panels.append(Panel(svg=svg, title=title))
    columns = [Column("joint", "joint", "integer")]
    for key in ("mean", "std"):
        columns.append(Column(f"first_{key}", f"{first.name} {key}", "number"))
        columns.append(Column(f"second_{key}", f"{second.name} {key}", "number"))
        columns.append(Column(f"{key}_change", "difference", "signed"))
    columns.append(Column("paper_std_change", "paper", "signed"))
    sources = [evaluation.folder / "steps.parquet" for evaluation in evaluations]
    words = f"Joint angles of {first.name} and {second.name} [rad]"
    return Figure(
        table=table_of(task, "joints", words, columns, rows, sources),
        caption=f"Differences: {first.name} minus {second.name} [rad]; std: standard deviation. "
        "Dashed: means. One trained network per agent: another training seed may change them as "
        "much as the knowledge does.",
        panels=panels,
        legend=[(each.name, task.colours[each.name]) for each in (first, second)],
    )


def film_blocks(task: TaskData) -> list[Films]:
    """Show agents on the same episodes: the policy's images as a strip and as an animation."""
    first = (*task.subjects, task.baseline)
    groups = sorted(task.groups, key=lambda group: group not in first)
    filmed = [(g.name, g.best) for g in groups if g.best and g.best.films()][:MOST_AGENTS]
    filmed += [(r.name, r.evaluations[0]) for r in task.references if r.evaluations[0].films()]
    if not filmed:
        return []
    common = set.intersection(*(set(evaluation.films()) for _, evaluation in filmed))
    blocks = []
    with suppress(UserError):
        for number, shown in _first_of_each_target(filmed[0][1], sorted(common)):
            title = f"Episode {number}, {shown}"
            films = [_film(name, task.colours[name], each, number) for name, each in filmed]
            blocks.append(Films(title=title, films=films))
    return blocks


def _first_of_each_target(evaluation: Evaluation, numbers: list[int]) -> list[tuple[int, str]]:
    """Return the number of the first episode of each target, with its object and query."""
    episodes = evaluation.episodes()
    first: dict[str, tuple[int, str]] = {}
    for number in numbers:
        shown = format.facet(str(episodes["facet"][number]))
        if "query" in episodes:
            shown = f"asked for \u201c{query_words(str(episodes['query'][number]))}\u201d ({shown})"
        first.setdefault(str(episodes["target"][number]), (number, shown))
    return sorted(first.values())[:MOST_EPISODES]


def query_words(text: str) -> str:
    """Return a query in words: "hasColor light_blue" as "has color light blue"."""
    return " ".join(label_of(word, {}) for word in text.split(" "))


def _film(name: str, colour: str, evaluation: Evaluation, number: int) -> Film:
    path = evaluation.films()[number]
    frames = read_film(path)
    episodes = evaluation.episodes()
    length = int(episodes["length"][number])
    outcome = "reached after" if episodes["success"][number] else "not reached in"
    if {"chosen", "choice_correct"} <= set(episodes) and not episodes["choice_correct"][number]:
        outcome = f"chose the {format.facet(str(episodes['chosen'][number]))}, {outcome}"
    places = np.unique(np.linspace(0, len(frames) - 1, min(STRIP_FRAMES, len(frames))).round())
    height, width = frames.shape[1:3]
    return Film(
        name=name,
        colour=colour,
        strip=[(_png(frames[int(i)]), f"step {int(i)}") for i in places],
        moving=data_uri("WEBP", path.read_bytes()),
        poster=_png(frames[-1]),
        size=(width, height),
        text=f"{outcome} {length} steps; at the end {episodes['distance_m'][number] * 100:.1f} cm "
        f"and {episodes['angle_deg'][number]:.0f}° from the grasp pose",
    )


def _png(image: np.ndarray) -> str:
    return data_uri("PNG", encode(image, "PNG", optimize=True))
