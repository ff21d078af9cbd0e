"""Figures of the table on README and start page are those of the committed packs."""

import csv
import json
import re
import tarfile
from collections import defaultdict
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.test_answer_page import agents_of

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "results"


@cache
def shares(pack):
    """Return the values in percent by experiment, split and measure, one per training seed."""
    found = defaultdict(list)
    with tarfile.open(RESULTS / f"{pack}.tar.xz") as file:
        for member in file:
            pattern = r"([\w-]+)/\d/evaluation/[a-z-]+-(\w+)/summary"
            if at := re.search(pattern, member.name):
                numbers = json.load(file.extractfile(member))["numbers"]
                for measure in ("choice", "success"):
                    value = 100 * numbers[measure]["estimate"]
                    found[at[1], at[2], measure].append(value)
    return found


def span(values):
    low, high = f"{min(values):.0f}", f"{max(values):.0f}"
    return low if low == high else f"{low} to {high}"


def means(pack, algorithm, split, measure):
    """Return the mean over five seeds of each robot."""
    chosen = [
        values
        for (name, where, what), values in shares(pack).items()
        if (where, what) == (split, measure) and name.endswith(f"-answers-{algorithm}")
    ]
    assert [len(each) for each in chosen] == [5, 5]
    return [np.mean(each) for each in chosen]


def of_seeds(agent):
    values = shares("choose")[f"irb120-choose-{agent}-fast", "s4", "choice"]
    assert len(values) == 3
    return span(values)


def lifted():
    rows = list(csv.DictReader((RESULTS / "lift.csv").read_text("utf-8").splitlines()))
    assert len(rows) == 6
    return span([100 * float(row["lifted"]) for row in rows])


def reached():
    """Return success with and without knowledge of each robot, fixed colours."""
    for cell in ("IRB120, fixed colours", "TIAGo, fixed colours"):
        agents = agents_of(cell)
        for name in ("full", "bm"):
            assert agents[name][0] >= 5
            yield agents[name][1].split()[0]


def grasps():
    """Return the share of reached poses that lift, of each robot by the paper's thresholds."""
    page = (RESULTS / "grasp.md").read_text("utf-8")
    row = r"^\| `(?:irb120|tiago)-full-fast` \| 10 cm.*?\| 100 \| 100 .*?\| \d+ .*?\| (\d+) \["
    return span([int(each) for each in re.findall(row, page, re.M)])


def picked(task):
    """Return the success of what is seen and solved, of each robot on S1."""
    text = (RESULTS / "pick-and-place.csv").read_text("utf-8")
    rows = csv.DictReader(text.splitlines())
    return [
        100 * float(row["success"])
        for row in rows
        if (row["task"], row["agent"], row["split"]) == (task, "seen", "S1")
    ]


@pytest.mark.parametrize("file", ["README.md", "docs/index.md"])
def test_the_answers_are_those_of_the_packs(file):
    rows = re.findall(r"^\| .+\? \| (.+) \|$", (ROOT / file).read_text("utf-8"), re.M)
    reach, words, objects, grasp, pick = (
        re.sub(r"\[(.+?)\]\(.+?\)", r"\1", row) for row in rows
    )
    with_it, without, tiago_with, tiago_without = reached()
    assert reach == (
        f"Not found: success {with_it} % with it, {without} % without (IRB120); "
        f"{tiago_with} % and {tiago_without} % (TIAGo)"
    )
    assert words == (
        f"Yes: {of_seeds('subgraph')} % right by the graph's vector, {of_seeds('query-onehot')} % "
        f"by codes, 25 % by chance; {span(means('answers', 'fast', 's4', 'choice'))} % if the "
        "graph itself answers"
    )
    new, kinds = (("answers", "fast", "s3"), ("families", "distil", "s3b"))
    assert objects == (
        f"Hardly: {span(means(*new, 'choice'))} % right, {span(means(*new, 'success'))} % succeed; "
        f"of kinds never trained {span(means(*kinds, 'choice'))} % right, "
        f"{span(means(*kinds, 'success'))} % succeed"
    )
    assert grasp == (
        f"Rarely: {grasps()} % of the reached poses lift it; policies trained to lift lift "
        f"{lifted()} %"
    )
    assert pick == (
        "By seeing, then solving: the right one of four is picked in "
        f"{span(picked('choose-lift'))} %, put on a tray in {span(picked('choose-place'))} % "
        "(one network per robot)"
    )


def test_the_worst_split_of_each_pack_is_named():
    for pack, algorithm, worst in (
        ("answers", "fast", "s3"),
        ("families", "distil", "s3b"),
    ):
        for measure in ("choice", "success"):
            splits = {split for _, split, what in shares(pack) if what == measure}
            least = {
                split: np.mean(means(pack, algorithm, split, measure))
                for split in splits
            }
            assert min(least, key=least.get) == worst


def test_the_page_shows_what_was_seen_and_solved_as_it_is_in_the_table():
    page = (RESULTS / "answers.md").read_text("utf-8")
    text = (RESULTS / "seen.csv").read_text("utf-8")
    for row in csv.DictReader(text.splitlines()):
        name = {"irb120": "IRB120", "tiago": "TIAGo"}[row["robot"]]
        what = {"seen": "seen and solved", "policy": "policy"}[row["acts"]]
        (line,) = (
            line for line in page.splitlines() if line.startswith(f"| {name}, {what} |")
        )
        success, low, high, right = (
            f"{100 * float(row[key]):.1f}"
            for key in ("success", "success_low", "success_high", "right")
        )
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        column = {"0.1": 1, "0.05": 2}[row["distance_m"]]
        assert cells[column] == f"{success} [{low}, {high}] ({right})"


def test_the_page_shows_what_was_picked_and_placed_as_it_is_in_the_table():
    page = (RESULTS / "pick-and-place.md").read_text("utf-8")
    text = (RESULTS / "pick-and-place.csv").read_text("utf-8")
    columns = [
        (task, robot) for task in ("lift", "place") for robot in ("tiago", "irb120")
    ]
    for row in csv.DictReader(text.splitlines()):
        start = {"oracle": "| `oracle` |"}.get(row["agent"])
        start = start or f"| `{row['agent']}`, {row['split']} |"
        (line,) = (line for line in page.splitlines() if line.startswith(start))
        success, low, high = (
            100 * float(row[key]) for key in ("success", "success_low", "success_high")
        )
        shown = f"{success:.1f} [{low:.0f}, {high:.0f}]"
        if row["right"]:
            shown += f" ({100 * float(row['right']):.1f})"
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        column = columns.index((row["task"].removeprefix("choose-"), row["robot"]))
        assert cells[1 + column] == shown
