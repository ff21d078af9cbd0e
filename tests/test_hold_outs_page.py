"""Intervals over seeds and hold-outs on the pages, recomputed from the packs' episodes."""

import io
import re
import tarfile
from collections import defaultdict
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import scipy

from knowarm.knowledge.queries.splits import topic_of

RESULTS = Path(__file__).parents[1] / "docs" / "results"
NUMBER = re.compile(r"[-+]?\d+\.\d+")
TOPICS = {
    "s3": lambda row: row["target"],
    "s3a": lambda row: row["target"],
    "s3b": lambda row: row["target"].rsplit("-", 1)[0],
    "s4": lambda row: row["query"].split(" and ")[0],
}
TABLES = {
    # page, column of counts that only this table has; experiments by row
    "answers": (
        "answers.md",
        "271 queries",
        ["irb120-choose-answers-fast", "tiago-choose-answers-fast"],
    ),
    "families": (
        "answers.md",
        "150 queries",
        ["irb120-families-answers-distil", "tiago-families-answers-distil"],
    ),
    "purpose": (
        "grasp.md",
        "177 queries",
        [
            "irb120-purpose-answers-distil",
            "irb120-purpose-answers-shuffled-distil",
        ],
    ),
}


@cache
def episodes_of(pack):
    """Return arrays of seeds, topics, right choices and successes by experiment and split."""
    lines = defaultdict(list)
    pattern = r"([\w-]+)/(\d)/evaluation/[a-z-]+-(s\w+)/episodes"
    with tarfile.open(RESULTS / f"{pack}.tar.xz") as file:
        for member in file:
            if at := re.search(pattern, member.name):
                topic = TOPICS.get(at[3], lambda row: row["query"])
                content = io.BytesIO(file.extractfile(member).read())
                for row in pq.read_table(content).to_pylist():
                    line = (at[2], topic(row), row["choice_correct"], row["success"])
                    lines[at[1], at[3]].append(line)
    columns = {}
    for key, rows in lines.items():
        columns[key] = [np.array(part) for part in zip(*rows, strict=True)]
    return columns


def table(page, count):
    """Return the header, the rows and the last row of the table of a page with a count."""
    text = (RESULTS / page).read_text("utf-8")
    (block,) = (
        part for part in re.findall(r"(?:^\|.+\n)+", text, re.M) if count in part
    )
    rows = [
        [cell.strip() for cell in row.strip("|").split("|")]
        for row in block.splitlines()
    ]
    header, _, *rows, last = rows
    return header, rows, last


def left_out(values, groups):
    """Return the mean of all values but those of each group."""
    return {name: values[groups != name].mean() for name in set(groups)}


def half_width(estimate, dimensions):
    """Return half of Student's interval of the jackknife, by its formula."""
    variances, freedom = [], []
    for means in dimensions:
        count = len(means)
        distances = sum((mean - estimate) ** 2 for mean in means)
        variances.append((count - 1) / count * distances)
        freedom.append(count - 1)
    satterthwaite = sum(variances) ** 2 / sum(
        variance**2 / degrees
        for variance, degrees in zip(variances, freedom, strict=True)
    )
    return scipy.stats.t(satterthwaite).ppf(0.975) * sum(variances) ** 0.5


def share_of(hits, seeds, topics):
    """Return a share and its interval in percent."""
    share = hits.mean()
    means = [left_out(hits, groups).values() for groups in (seeds, topics)]
    half = half_width(share, means) / share / (1 - share)
    odds = share / (1 - share)
    ends = [odds * np.exp(sign * half) for sign in (-1, 1)]
    return [100 * share, *(100 * end / (1 + end) for end in ends)]


@pytest.mark.parametrize("pack", TABLES)
def test_intervals_cover_what_is_held_out(pack):
    page, count, experiments = TABLES[pack]
    header, rows, last = table(page, count)
    splits = [title.split()[0].lower() for title in header[2:]]
    assert {split for _, split in episodes_of(pack)} == set(splits)
    checked = 0
    experiment = None
    for first, measure, *cells in rows:
        if first:
            experiment = experiments[checked // 2]
        for split, cell in zip(splits, cells, strict=True):
            seeds, topics, right, success = episodes_of(pack)[experiment, split]
            assert len(set(seeds)) == 5
            hits = success if measure == "success" else right
            printed = [float(number) for number in NUMBER.findall(cell)]
            expected = share_of(hits, seeds, topics)
            assert printed == pytest.approx(expected, abs=0.051)
        checked += 1
    assert checked == (3 if pack == "purpose" else 4)
    for split, cell in zip(splits, last[2:], strict=True):
        topics = {
            topic
            for experiment in experiments
            for topic in episodes_of(pack)[experiment, split][1]
        }
        assert int(cell.split()[0]) == len(topics)


def test_differences_cover_what_is_held_out():
    header, rows, last = table("choose.md", "283 queries")
    found = episodes_of("choose")
    assert [row[0] for row in rows] == [
        f"`{name}`" for name in ("query-onehot", "query-words", "subgraph-shuffled")
    ]
    for control, *cells in rows:
        for split, cell in zip(header[1:], cells, strict=True):
            arms = [
                found[f"irb120-choose-{name}-fast", split.lower()]
                for name in ("subgraph", control.strip("`"))
            ]
            (seeds, topics, right, _), (others, topics_of_others, theirs, _) = arms
            assert len(set(seeds)) == len(set(others)) == 3
            assert set(topics) == set(topics_of_others)
            difference = right.mean() - theirs.mean()
            of_topics = left_out(theirs, topics_of_others)
            dimensions = [
                [mean - theirs.mean() for mean in left_out(right, seeds).values()],
                [right.mean() - mean for mean in left_out(theirs, others).values()],
                [
                    mean - of_topics[topic]
                    for topic, mean in left_out(right, topics).items()
                ],
            ]
            half = half_width(difference, dimensions)
            expected = [difference, difference - half, difference + half]
            printed = [float(number) for number in NUMBER.findall(cell)]
            assert printed == pytest.approx([100 * end for end in expected], abs=0.051)
    for split, cell in zip(header[1:], last[1:], strict=True):
        topics = found["irb120-choose-subgraph-fast", split.lower()][1]
        assert int(cell.split()[0]) == len(set(topics))


def test_the_page_names_the_objects_and_kinds_that_widen_the_intervals():
    page = " ".join((RESULTS / "answers.md").read_text("utf-8").split())

    def reached(pack, experiment, split, topic):
        _, topics, _, success = episodes_of(pack)[experiment, split]
        return f"{100 * success[topics == topic].mean():.0f}"

    for robot in ("irb120", "tiago"):
        can, watering_can = (
            reached("answers", f"{robot}-choose-answers-fast", "s3", name)
            for name in ("can", "watering_can")
        )
        sentence = f"the can is reached in {can} %, the watering can in {watering_can}."
        assert f"of six {sentence}" in page
    bowl, candle = (
        [
            reached("families", f"{robot}-families-answers-distil", "s3b", name)
            for robot in ("irb120", "tiago")
        ]
        for name in ("bowl", "candle")
    )
    assert (
        f"of these four the bowl is reached in {bowl[0]} (IRB120) and {bowl[1]} % (TIAGo), the "
        f"candle in {candle[0]} and {candle[1]}"
    ) in page


def interval(share, unit):
    estimate, low, high = share
    return f"{estimate:.1f}{unit} [{low:.1f}, {high:.1f}]"


def test_the_intervals_of_imitation_are_those_of_its_episodes():
    page = " ".join((RESULTS / "answers.md").read_text("utf-8").split())
    right, success, of_known = [], [], {"right": [], "success": []}
    for robot in ("irb120", "tiago"):
        experiment = f"{robot}-choose-answers-distil"
        for split in ("s1", "s2", "s3", "s4", "s5"):
            seeds, topics, *hits = episodes_of("answers-distil")[experiment, split]
            shares = [share_of(each, seeds, topics) for each in hits]
            if split == "s3":
                unit = " %" if robot == "tiago" else ""
                right.append(interval(shares[0], unit))
                success.append(interval(shares[1], unit))
            else:
                of_known["right"].append(shares[0])
                of_known["success"].append(shares[1])
    lines = []
    for shares in of_known.values():
        estimates, lows, _ = zip(*shares, strict=True)
        lines.append((min(estimates), max(estimates), min(lows)))
    (least, most, low), (least_success, most_success, low_success) = lines
    assert (
        f"right in {least:.1f} to {most:.1f} % and succeeds in {least_success:.1f} to "
        f"{most_success:.1f} %** (intervals as above: from {low:.1f} and {low_success:.1f})"
    ) in page
    unknown = f"right in {' and '.join(right)} and succeeds in {' and '.join(success)}."
    assert unknown in page


def test_a_split_is_a_draw_of_its_topics():
    query = "usedFor drinking and hasColor red"
    assert topic_of("S1", query, "mug-3") == query
    assert topic_of("S3a", query, "mug-3") == "mug-3"
    assert topic_of("S3b", query, "wine_glass-3") == "wine_glass"
    assert topic_of("S4", query, "mug-3") == "usedFor drinking"
    assert topic_of("S4", "usedFor drinking", "mug-3") == "usedFor drinking"
