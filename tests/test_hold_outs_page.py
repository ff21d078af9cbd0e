"""The tables of answers.md, recomputed episode by episode from the packs by other code."""

import io
import re
import tarfile
from collections import defaultdict
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from scripts.hold_outs import topic_of

RESULTS = Path(__file__).parents[1] / "docs" / "results"
NUMBER = re.compile(r"[\d.]+")
TOPICS = {
    "S3": lambda row: row["target"],
    "S3a": lambda row: row["target"],
    "S3b": lambda row: row["target"].rsplit("-", 1)[0],
    "S4": lambda row: row["query"].split(" and hasColor ")[0],
}


def printed(experiment):
    """Return the cells of the page by robot, measure and split, and the last rows' counts."""
    page = (RESULTS / "answers.md").read_text("utf-8")
    section = page.split("## Families")[experiment == "families"]
    rows = re.findall(r"^\|(.+)\|$", section, re.M)
    header, _, *rows = [[cell.strip() for cell in row.split("|")] for row in rows]
    splits = [title.split()[0] for title in header[2:]]
    cells = {}
    robot = ""
    for name, measure, *values in rows[:4]:
        robot = name or robot
        for split, value in zip(splits, values, strict=True):
            cells[robot, measure, split] = [float(n) for n in NUMBER.findall(value)]
    assert rows[4][:2] == ["", ""]
    counts = {
        split: int(cell.split()[0])
        for split, cell in zip(splits, rows[4][2:], strict=True)
    }
    return cells, counts


def episodes_of(pack, task, agent):
    """Return lists of (seed, topic, right, success) by robot and split."""
    found = defaultdict(list)
    pattern = rf"(irb120|tiago)-{task}-{agent}/(\d)/evaluation/[a-z-]+-(\w+)/episodes"
    with tarfile.open(RESULTS / f"{pack}.tar.xz") as file:
        for member in file:
            if at := re.search(pattern, member.name):
                split = at[3].capitalize()
                topic = TOPICS.get(split, lambda row: row["query"])
                content = io.BytesIO(file.extractfile(member).read())
                for row in pq.read_table(content).to_pylist():
                    line = (at[2], topic(row), row["choice_correct"], row["success"])
                    robot = {"irb120": "IRB120", "tiago": "TIAGo"}[at[1]]
                    found[robot, split].append(line)
    return found


@pytest.mark.parametrize(
    ("pack", "task", "agent"),
    [
        ("answers", "choose", "answers-fast"),
        ("families", "families", "answers-distil"),
    ],
)
def test_intervals_cover_what_is_held_out(pack, task, agent):
    cells, counts = printed(pack)
    found = episodes_of(pack, task, agent)
    assert {(robot, split) for robot, _, split in cells} == set(found)
    generator = np.random.default_rng(1)
    topics_of_splits = defaultdict(set)
    for (robot, split), lines in found.items():
        seeds = sorted({seed for seed, *_ in lines})
        topics = sorted({topic for _, topic, *_ in lines})
        topics_of_splits[split] |= set(topics)
        assert len(seeds) == 5
        drawn = []
        for _ in range(400):
            of_seeds = np.bincount(generator.integers(0, 5, 5), minlength=5)
            chosen = generator.integers(0, len(topics), len(topics))
            of_topics = np.bincount(chosen, minlength=len(topics))
            drawn.append((of_seeds, of_topics))
        rows = np.array([seeds.index(seed) for seed, *_ in lines])
        columns = np.array([topics.index(topic) for _, topic, *_ in lines])
        for number, measure in enumerate(("right", "success"), start=2):
            hits = np.array([line[number] for line in lines], float)
            means = [
                np.average(hits, weights=of_seeds[rows] * of_topics[columns])
                for of_seeds, of_topics in drawn
            ]
            share, low, high = cells[robot, measure, split]
            assert share == pytest.approx(100 * hits.mean(), abs=0.051)
            width = high - low
            ends = 100 * np.quantile(means, [0.025, 0.975])
            assert [low, high] == pytest.approx(ends, abs=0.1 + 0.15 * width)
    assert {split: len(topics) for split, topics in topics_of_splits.items()} == counts


def test_a_split_is_a_draw_of_its_topics():
    query = "usedFor drinking and hasColor red"
    assert topic_of("s1", query, "mug-3") == query
    assert topic_of("s3a", query, "mug-3") == "mug-3"
    assert topic_of("s3b", query, "wine_glass-3") == "wine_glass"
    assert topic_of("s4", query, "mug-3") == "usedFor drinking"
    assert topic_of("s4", "usedFor drinking", "mug-3") == "usedFor drinking"
