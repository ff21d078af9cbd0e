"""The page on minimal pairs, recomputed from its CSV file by other code than the page's."""

import csv
import re
import subprocess
import sys
from collections import defaultdict
from math import sqrt
from pathlib import Path

import numpy as np
import pytest

from knowarm.benchmark.suites import read_suite
from knowarm.world.envs.episodes import evaluation_episodes
from scripts import build_pairs
from scripts.build_pairs import Run, page, planned, shown, verdicts

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "results" / "minimal-pairs.md"
Z = 1.959963984540054  # of a 95 % interval


def pairs_by_arm():
    """Read the lines of the CSV file by arm."""
    arms = defaultdict(list)
    with PAGE.with_suffix(".csv").open(encoding="utf-8", newline="") as file:
        for line in csv.DictReader(file):
            name = f"`{line['experiment']}`"
            arms[name + (f", {line['test']}" if line["test"] else "")].append(line)
    return arms


def wilson(hits):
    """Return a share with Wilson's interval in percent, by the formula."""
    count, share = len(hits), sum(hits) / len(hits)
    middle = share + Z * Z / (2 * count)
    half = Z * sqrt(share * (1 - share) / count + Z * Z / (4 * count * count))
    low, high = ((middle + sign * half) / (1 + Z * Z / count) for sign in (-1, 1))
    return [100 * share, 100 * low, 100 * high]


def moved(lines):
    """Return the primary outcome with Newcombe's interval in percent, by the formula."""
    of_new, of_placebo = (
        wilson([line[f"chosen_{version}"] == line["new_answer"] for line in lines])
        for version in ("deciding", "placebo")
    )
    (first, low, high), (second, least, most) = of_new, of_placebo
    below = sqrt((first - low) ** 2 + (most - second) ** 2)
    above = sqrt((high - first) ** 2 + (second - least) ** 2)
    return [first - second, first - second - below, first - second + above]


def expected(lines):
    """Recompute the cells of an arm's row."""
    flips = [line["chosen_deciding"] == line["new_answer"] for line in lines]
    shown = [line["fact_kind"] == "shown" for line in lines]
    right = [line["chosen_true"] == line["target"] for line in lines]
    same = [line["chosen_placebo"] == line["target"] for line in lines]
    return [
        right,
        flips,
        [line["chosen_placebo"] != line["chosen_true"] for line in lines],
        [line["chosen_removal"] == "" for line in lines],
        [
            line["chosen_foreign"] == line["told_answer"]
            for line in lines
            if line["told_answer"]
        ],
        [all(each) for each in zip(right, flips, same, strict=True)],
        [flip for flip, is_shown in zip(flips, shown, strict=True) if is_shown],
        [flip for flip, is_shown in zip(flips, shown, strict=True) if not is_shown],
    ]


def test_every_number_of_the_table_follows_from_the_lines():
    arms = pairs_by_arm()
    rows = re.findall(
        r"^\| (`.+?) \| 1 \| (\d+) \| (.+) \|$", PAGE.read_text("utf-8"), re.M
    )
    assert [name for name, _, _ in rows] == list(arms)
    for name, count, cells in rows:
        assert int(count) == len(arms[name])
        first, *others = cells.split(" | ")
        printed = [float(number) for number in re.findall(r"-?[\d.]+", first)]
        assert printed == pytest.approx(moved(arms[name]), abs=0.051), name
        for cell, hits in zip(others, expected(arms[name]), strict=True):
            printed = [float(number) for number in re.findall(r"[\d.]+", cell)]
            assert printed == pytest.approx(wilson(hits), abs=0.051), (name, cell)
    last = max(int(line["episode"]) for lines in arms.values() for line in lines)
    text = " ".join(PAGE.read_text("utf-8").split())
    assert f"one network each, the first {last + 1} episodes" in text


def test_the_first_sentence_follows_from_the_lines():
    flips = {
        name: np.mean(expected(lines)[1]) for name, lines in pairs_by_arm().items()
    }
    first = " ".join(PAGE.read_text("utf-8").split("**")[1].split())
    for pick in (max, min):
        name = pick(flips, key=flips.get)
        assert name in first
        assert re.search(rf"\b{100 * flips[name]:.0f} %", first)


def test_the_table_of_results_has_the_primary_outcome():
    by_arm = [moved(lines)[0] for lines in pairs_by_arm().values()]
    most, least = (f"{each:.0f}" for each in (max(by_arm), min(by_arm)))
    row = f"moved by {most} points if the graph answers, by {least} with its vector"
    assert f"| {row}; one network each |" in PAGE.with_name("README.md").read_text()


def test_page_and_figure_are_what_the_lines_say(tmp_path):
    out, drawn = tmp_path / "page.md", tmp_path / "figure.svg"
    command = [
        sys.executable,
        "-m",
        "scripts.build_pairs",
        "--out",
        out,
        "--figure",
        drawn,
    ]
    subprocess.run(command, check=True, cwd=ROOT)
    assert out.read_text("utf-8") == PAGE.read_text("utf-8")
    figure = ROOT / "docs" / "images" / "minimal-pairs.svg"
    assert drawn.read_text("utf-8") == figure.read_text("utf-8")


def arm(experiment, seeds, flips, false_flips, pairs=40, to="d"):
    """Make runs that flip in a share of the pairs, with noise between seeds.

    After the placebo edit they end at ``to`` in a share of the pairs; "b" is the new answer.
    """
    runs = []
    rng = np.random.default_rng(len(experiment))
    for seed in range(seeds):
        texts = {name: np.full(pairs, "a", "U8") for name in build_pairs.TEXTS}
        texts["new_answer"][:] = "b"
        texts["fact_kind"][:] = "shown"
        texts["told_answer"][:] = "c"
        texts["chosen_deciding"][rng.random(pairs) < flips] = "b"
        texts["chosen_placebo"][rng.random(pairs) < false_flips] = to
        texts["episode"] = np.arange(pairs).astype(str)
        texts["fact"] = texts["episode"]
        runs.append(Run(experiment, "", seed, texts))
    return runs


SEEDS = {
    ("irb120-choose-bm-distil", ""): set(range(6)),
    ("acts", ""): set(range(6)),
    ("seldom", ""): set(range(6)),
    ("restless", ""): set(range(6)),
    ("deaf", ""): set(range(6)),
}


def made_arms():
    return {
        ("irb120-choose-bm-distil", ""): arm("bm", 6, 0.25, 0.25, to="b"),
        ("acts", ""): arm("acts", 6, 0.9, 0.05),
        ("seldom", ""): arm("seldom", 6, 0.15, 0.02),
        ("restless", ""): arm("restless", 6, 0.6, 0.7),
        ("deaf", ""): arm("deaf", 6, 0.05, 0.05, to="b"),
    }


def test_an_arm_acts_if_the_deciding_edit_moves_it_and_the_placebo_does_not():
    lines = verdicts(made_arms(), SEEDS)
    decided = dict(
        re.findall(
            r"`([\w-]+)` (acts on|is not shown to act on) the fact", "".join(lines)
        )
    )
    assert decided == {
        "irb120-choose-bm-distil": "is not shown to act on",
        "acts": "acts on",
        "seldom": "acts on",  # though one that ends anywhere flips in 25 %
        "restless": "is not shown to act on",
        "deaf": "is not shown to act on",
    }


def test_an_arm_moved_by_one_fact_of_many_is_not_shown_to_act():
    arms = made_arms()
    for run in arms["acts", ""]:
        few = np.arange(40) < 24
        run.columns["fact"][:] = np.where(few, "the fact", np.arange(40).astype(str))
        run.columns["chosen_deciding"][:] = np.where(few, "b", "a")
        run.columns["chosen_placebo"][:] = "a"
    (line,) = (line for line in verdicts(arms, SEEDS) if "`acts`" in line)
    assert "is not shown to act" in line
    assert "over seeds and facts 60.0 [-64.0, " in line


def test_arms_whose_seeds_miss_are_said_to_be_begun_and_nothing_else():
    arms = made_arms()
    arms["acts", ""].pop()
    assert verdicts(arms, SEEDS) == []
    text = " ".join(page(arms, SEEDS).split())
    assert "29 of 30 evaluations are there: begun." in text
    assert "Training seeds miss in 1 of 5 arms" in text
    assert {len(runs) for runs in shown(arms, SEEDS).values()} == {5}
    assert "| `restless` | 5 | 40 |" in text
    assert shown({}, SEEDS) == {}
    arms["acts", ""] = []
    assert shown(arms, SEEDS) == {}
    assert "not begun" in page({("x-fast", ""): arm("x", 1, 0.5, 0)}, SEEDS)


def test_the_declared_episodes_are_those_of_the_frozen_suite():
    study = build_pairs.read_study("minimal-pairs")
    (config,) = study.evaluations
    cell = read_suite("choose-v1").cells["irb120-S1"]
    assert config.episodes == len(cell.episodes)
    episodes = evaluation_episodes(cell.env, 40, config.seed)
    for name in ("objects", "colours", "positions", "question", "joint_offsets"):
        stored = getattr(cell.episodes, name)[:40]
        assert np.array_equal(stored, getattr(episodes, name))


def test_the_declared_arms_are_those_of_the_studies():
    seeds = planned([build_pairs.read_study(name) for name in build_pairs.STUDIES])
    assert len(seeds) == 14  # ten agents, three tests of one, and a clone
    assert {len(each) for each in seeds.values()} == {20}
    tests = {test for experiment, test in seeds if "answers-distil" in experiment}
    assert tests == {"", "stop", "colours", "graph-shuffled"}
