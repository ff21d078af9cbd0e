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

from knowarm.report.collect import collect
from knowarm.statistics import wilson
from knowarm.study.config import SHIPPED
from knowarm.study.pack import unpack_study
from scripts.build_paper import PACK, state
from tests.test_answer_page import CELLS, agents_of

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


def placed():
    rows = table_of("place.csv")
    assert len(rows) == 10
    return span([100 * float(row["placed"]) for row in rows])


def table_of(file):
    return list(csv.DictReader((RESULTS / file).read_text("utf-8").splitlines()))


def reached(agent):
    """Return the range of the success of an agent over the four cells."""
    values = []
    for cell in CELLS:
        seeds, success = agents_of(cell)[agent]
        assert seeds >= 5
        values.append(float(success.split()[0]))
    return f"{min(values)} to {max(values)} %"


def saved():
    """Return the steps to 80 % that `full` saves of those of `bm`, and the widest interval."""
    rows = [
        row
        for row in table_of("answer-comparisons.csv")
        if (row["first"], row["second"]) == ("full", "bm")
    ]
    assert len(rows) == 4
    mean, low, high = (
        [-float(row[f"steps_percent{end}"]) for row in rows]
        for end in ("", "_low", "_high")
    )
    return (
        f"{min(mean):.0f} to {max(mean):.0f} % of the steps to 80 % success saved (intervals "
        f"from {min(high):.0f} to {max(low):.0f} %)"
    )


def solved():
    """Return how often what is seen, then solved is right on new values, of each robot."""
    shares = []
    for robot in ("irb120", "tiago"):
        file = RESULTS / "benchmark" / "rows" / f"choose-{robot}-seen.json"
        cell = json.loads(file.read_text("utf-8"))["cells"][f"{robot}-S4"]
        shares.append(100 * cell["right"]["mean"])
    return span(shares)


def over_kinds():
    """Return the ends of both robots' intervals of success over seeds and new kinds."""
    page = (RESULTS / "answers.md").read_text("utf-8").split("## Families")[1]
    rows = [row.split("|") for row in re.findall(r"^\| \| success \|.+$", page, re.M)]
    assert len(rows) == 2
    ends = [re.findall(r"[\d.]+", row[6])[1:] for row in rows]
    return span([float(end) for pair in ends for end in pair])


def without_the_arm():
    """Return what the graph and the query's colour alone give among new objects, by robot."""
    page = " ".join((RESULTS / "answers.md").read_text("utf-8").split())
    (found,) = re.findall(
        r"\(right in (\d+) and (\d+) %, by colour in (\d+) and (\d+)\)", page
    )
    return " to ".join(found[:2]), " to ".join(found[2:])


def grasps():
    """Return the share of reached poses that lift, of each robot by the paper's thresholds."""
    page = (RESULTS / "grasp.md").read_text("utf-8")
    assert "| 10 cm, 17 degrees | success | lifted | grasps |" in page
    row = r"^\| `(?:irb120|tiago)-full-fast` \| 100 .*?\| \d+ .*?\| (\d+) \["
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


def sorting(robot, agent, split):
    """Return what each of five networks did in 100 episodes, (5, 100) bool by outcome."""
    rows = [
        row
        for row in table_of("sort.csv")
        if (row["robot"], row["agent"], row["split"]) == (robot, agent, split)
    ]
    assert [row["training_seed"] for row in rows] == list("01234")
    outcomes = ("success", "right", "on_tray", "right_tray")
    return {
        name: np.array([list(map(int, row[name])) for row in rows], bool)
        for name in outcomes
    }


def sorted_by_place():
    """Return the share of sorted episodes on S1 of each robot in percent."""
    return [
        100 * sorting(robot, "seen", "S1")["success"].mean()
        for robot in ("tiago", "irb120")
    ]


@pytest.mark.parametrize("file", ["README.md", "docs/index.md"])
def test_the_answers_are_those_of_the_packs(file):
    rows = re.findall(r"^\| .+\? \| (.+) \|$", (ROOT / file).read_text("utf-8"), re.M)
    reach, words, objects, grasp, pick = (
        re.sub(r"\[(.+?)\]\(.+?\)", r"\1", row) for row in rows
    )
    assert reach == (
        f"Not found in four cells: {saved()}; success {reached('full')} with it, "
        f"{reached('bm')} without"
    )
    assert words == (
        "Yes, if the graph itself answers: "
        f"{span(means('answers', 'fast', 's4', 'choice'))} % right, {solved()} % without a policy "
        "(one network per robot), 25 % by chance; by its vector "
        f"{of_seeds('subgraph')} %, by codes {of_seeds('query-onehot')} %, on too few words to "
        "say it of others"
    )
    graph_alone, colour_alone = without_the_arm()
    new, kinds = (("answers", "fast", "s3"), ("families", "distil", "s3b"))
    assert objects == (
        f"No: {span(means(*new, 'choice'))} % right; without the arm {graph_alone} %, by the "
        f"query's colour alone {colour_alone} %; "
        f"of kinds never trained {span(means(*kinds, 'choice'))} % right, "
        f"{span(means(*kinds, 'success'))} % succeed, over kinds {over_kinds()} %"
    )
    assert grasp == (
        f"Rarely: by the paper's thresholds {grasps()} % of the reached poses lift it; policies "
        f"trained to lift lift {lifted()} %"
    )
    assert pick == (
        "By seeing, then solving: the right one of four is picked in "
        f"{span(picked('choose-lift'))} %, put on a tray in {span(picked('choose-place'))} %, on "
        f"that of the place where it belongs in {span(sorted_by_place())} %"
        "; two and three objects are tidied up in "
        f"{tidied('tiago')} and {tidied('irb120')} % of "
        "scenes (one network per robot, five for places). Policies learn to place one object in "
        f"{placed()} %"
    )


def tidied(robot):
    """Return the share of scenes that are wholly tidy in percent."""
    (row,) = (
        row for row in tidy_rows() if (row["robot"], row["places"]) == (robot, "graph")
    )
    return round(100 * int(row["tidy_scenes"]) / int(row["scenes"]))


def tidy_rows():
    """Read what tidying counts."""
    text = (RESULTS / "tidy.csv").read_text("utf-8")
    return list(csv.DictReader(text.splitlines()))


def test_the_page_shows_what_was_tidied_as_it_is_in_the_table():
    page = (RESULTS / "pick-and-place.md").read_text("utf-8")
    lines = {}
    for line in page.split("## A plan from the graph")[1].splitlines():
        if line.startswith("| "):
            name, *cells = (cell.strip() for cell in line.strip("|").split("|"))
            lines[name] = cells
    counts = {
        "scenes wholly tidy": ("tidy_scenes", "scenes"),
        "objects in their places": ("in_place", "objects"),
        "scenes with an object on a wrong tray": ("on_a_wrong_tray", "scenes"),
        "scenes in which what should stay was moved": ("moved_scenes", "scenes"),
    }
    checked = 0
    for row in tidy_rows():
        for name, (count, total) in counts.items():
            title = name if row["places"] == "graph" else f"shuffled graph: {name}"
            if title not in lines:
                continue
            share = wilson(int(row[count]), int(row[total]))
            shown = f"{100 * share.estimate:.1f} [{100 * share.low:.0f}, {100 * share.high:.0f}]"
            assert lines[title][row["robot"] == "irb120"] == shown, title
            checked += 1
    assert checked == 12


def test_graphs_of_others_are_compared_with_the_colour_alone():
    page = (RESULTS / "other-graphs.md").read_text("utf-8")
    graph, colours = (
        np.array(re.findall(r"[\d.]+", line), float)
        for line in re.findall(
            r"^\| first images: (?:graph|colours only) \|(.+)\|$", page, re.M
        )
    )
    gain = f"{span(graph - colours)} points"
    assert f"in first images {gain} more often" in " ".join(page.split())
    readme = (RESULTS / "README.md").read_text("utf-8")
    assert f"in first images {gain} above the colour alone" in readme


def test_the_index_says_what_blind_agents_leave():
    page = " ".join((RESULTS / "vision.md").read_text("utf-8").split())
    (ends,) = re.findall(
        r"agent by ([\d.]+) to ([\d.]+) points .+? and ([\d.]+) to ([\d.]+) \(TIAGo",
        page,
    )
    gain = span([float(end) for end in ends])
    readme = (RESULTS / "README.md").read_text("utf-8")
    assert f"| {gain} points above the best blind agent |" in readme


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
    first, second = page.split("## The graph says where, too")
    robots = ("tiago", "irb120")
    columns = [(task, robot) for task in ("lift", "place") for robot in robots]
    columns += [("sort", robot) for robot in robots]
    for row in csv.DictReader(text.splitlines()):
        start = {"oracle": "| `oracle` |"}.get(row["agent"])
        start = start or f"| `{row['agent']}`, {row['split']} |"
        part = second if row["task"] == "choose-sort" else first
        (line,) = (line for line in part.splitlines() if line.startswith(start))
        success, low, high = (
            100 * float(row[key]) for key in ("success", "success_low", "success_high")
        )
        shown = f"{success:.1f} [{low:.0f}, {high:.0f}]"
        shares = [row[name] for name in ("right", "right_tray") if row[name]]
        if shares:
            shown += f" ({', '.join(f'{100 * float(share):.1f}' for share in shares)})"
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        column = columns.index((row["task"].removeprefix("choose-"), row["robot"])) % 4
        assert cells[1 + column] == shown


def over_networks_and_episodes(hits):
    """Return an interval by drawing networks and episodes anew, both at once, in percent."""
    rng = np.random.default_rng(0)
    networks, episodes = hits.shape
    means = []
    for _ in range(2_000):
        rows = rng.integers(networks, size=networks)
        columns = rng.integers(episodes, size=episodes)
        means.append(hits[np.ix_(rows, columns)].mean())
    return 100 * np.quantile(means, [0.025, 0.975])


def test_the_page_shows_what_was_sorted_as_the_episodes_say():
    page = (RESULTS / "pick-and-place.md").read_text("utf-8")
    part = page.split("## The graph says where, too")[1].split("\n## ")[0]
    lines = re.findall(r"^\| `([\w-]+)`, (S\d) \| (.+) \| (.+) \|$", part, re.M)
    played = {(row["agent"], row["split"]) for row in table_of("sort.csv")}
    played.remove(("blind", "S1"))
    assert {(agent, split) for agent, split, _, _ in lines} == played
    assert len(lines) == 9
    for agent, split, *cells in lines:
        for robot, cell in zip(("tiago", "irb120"), cells, strict=True):
            outcomes = sorting(robot, agent, split)
            success, low, high, right, right_tray = map(
                float, re.findall(r"[\d.]+", cell)
            )
            hits = outcomes["success"]
            assert success == pytest.approx(100 * hits.mean(), abs=0.051)
            assert right == pytest.approx(100 * outcomes["right"].mean(), abs=0.051)
            of_tray = outcomes["right_tray"].sum() / outcomes["on_tray"].sum()
            assert right_tray == pytest.approx(100 * of_tray, abs=0.051)
            # Another interval than the page's, which is a jackknife
            again = over_networks_and_episodes(hits)
            assert [low, high] == pytest.approx(again, abs=4.5), (agent, split, robot)
    assert "On black images (`blind`) no network sorts any of its" in part
    for robot in ("tiago", "irb120"):
        assert not sorting(robot, "blind", "S1")["success"].any()


BEGUN = (
    "README.md",
    "docs/faq.md",
    "docs/decisions.md",
    "docs/reference/paper.md",
    "docs/results/README.md",
    "docs/results/paper.md",
)
"""Files that say how far the paper's algorithm has come."""


def test_all_files_say_the_same_of_the_papers_algorithm(tmp_path):
    said = state(collect([unpack_study(PACK, tmp_path / "study")]).tasks)
    assert re.search(
        r"of its twelve cells .* million steps|all twelve .* complete", said
    )
    for file in BEGUN:
        text = " ".join((ROOT / file).read_text("utf-8").split())
        assert text.count(said) == text.count("of its twelve cells") == 1, file


def test_learning_has_the_medians_of_all_runs():
    runs = defaultdict(list)
    for row in table_of("answer-runs.csv"):
        name = f"{row['robot']}-{row['agent']}" + "-dr" * (row["colours"] != "fixed")
        runs[name].append((float(row["million_steps"]), float(row["success_percent"])))
    page = (RESULTS / "learning.md").read_text("utf-8")
    rows = re.findall(
        r"^\| `((?:irb120|tiago)-\w+(?:-dr)?)` \| (.+?) M \| (.+?) % ", page, re.M
    )
    assert len(rows) == 8
    for name, steps, success in rows:
        steps_of_all, success_of_all = zip(*runs[name], strict=True)
        assert len(steps_of_all) >= 5
        assert steps == f"{np.median(steps_of_all):.2f}".removeprefix("0"), name
        assert success == f"{np.mean(success_of_all):.1f}", name
    medians = [row[1] for row in rows]
    ends = " to ".join([min(medians, key=float), max(medians, key=float)])
    assert f"`fast` {ends} million in the median" in (RESULTS / "README.md").read_text()


def test_the_so101_places_as_often_as_its_runs_say():
    rows = table_of("so101-place.csv")
    assert [row["training_seed"] for row in rows] == list("01234")
    assert {row["steps"] for row in rows} == {"500224"}
    success = [100 * float(row["success"]) for row in rows]
    page = " ".join((RESULTS / "learning.md").read_text("utf-8").split())
    said = re.search(r"\*\*`distil` succeeds in ([\d.]+) % \[(\d+), (\d+)\]", page)
    mean, low, high = map(float, said.groups())
    assert mean == pytest.approx(np.mean(success), abs=0.05)
    # Another interval than the page's, which draws seeds anew: Student's t is wider.
    half = 2.776 * np.std(success, ddof=1) / np.sqrt(5)
    assert mean - half - 1 < low < mean < high < mean + half + 1
    blind = [float(row[agent]) for row in rows for agent in ("blind", "frozen")]
    assert max(blind) == max(float(row["open_loop"]) for row in rows) == 0


def test_placing_is_learned_as_often_as_its_runs_say():
    page = (RESULTS / "pick-and-place.md").read_text("utf-8")
    for name, robot in (("TIAGo", "tiago"), ("IRB120", "irb120")):
        rows = [row for row in table_of("place.csv") if row["robot"] == robot]
        assert [row["training_seed"] for row in rows] == list("01234")
        (line,) = re.findall(rf"^\| {name} \| (\*\*.+)$", page, re.M)
        said = [float(number) for number in re.findall(r"[\d.]+", line)]
        values = [100 * float(row["placed"]) for row in rows]
        mean, low, high = said[:3]
        assert mean == pytest.approx(np.mean(values), abs=0.05)
        assert min(values) < low < mean < high < max(values)
        columns = ("placed_mug", "placed_bottle", "open_loop", "blind", "frozen")
        means = [np.mean([100 * float(row[key]) for row in rows]) for key in columns]
        assert said[3:] == pytest.approx(means, abs=0.051)


def data_of_pages():
    """Return what the table of data names, by the pages of its rows."""
    table = (RESULTS / "README.md").read_text("utf-8").split("## Data")[1]
    found = {}
    for pages, data in re.findall(r"^\| (\[.+?) \| (.+) \|$", table, re.M):
        names = re.findall(r"`(.+?)`", data)
        for page in re.findall(r"\]\(([\w/-]+\.md)\)", pages):
            found[page] = names
    return found


def test_every_file_of_results_is_listed_and_every_listed_one_is_there():
    listed = {name for names in data_of_pages().values() for name in names}
    files = {
        file.name for file in RESULTS.iterdir() if file.suffix not in (".md", ".html")
    }
    assert files - {"benchmark"} <= listed
    assert "benchmark/rows" in listed
    others = {"zoo/", *SHIPPED}
    for name in listed - others:
        assert (RESULTS / name).exists(), name


def test_every_page_of_results_has_data_or_a_command():
    listed = data_of_pages()
    for page in RESULTS.glob("*.md"):
        text = page.read_text("utf-8")
        if page.name == "README.md" or listed.get(page.name):
            continue
        if page.name == "answer-cells.md":
            assert "`answer-comparisons.csv`" in text
            continue
        commands = re.findall(r"python\s+-m\s+benchmarks\.(\w+)", text)
        assert commands or re.search(r"`knowarm\s", text), page.name
        for name in commands:
            assert (ROOT / "benchmarks" / f"{name}.py").exists(), name


def test_imitation_has_the_medians_and_ranges_of_all_runs():
    runs = defaultdict(list)
    for run in json.loads((RESULTS / "imitation.json").read_text("utf-8")):
        runs[run["run"].split("/")[0]].append(run)
    page = (RESULTS / "learning.md").read_text("utf-8")
    rows = re.findall(r"^\| `([\w-]+-distil)` \| (.+) \|$", page, re.M)
    assert sorted(name for name, _ in rows) == sorted(runs)
    columns = {
        "steps to 80 %": (1000, 0.5),
        "seconds": (1, 0.051),
        "success %": (1, 0.051),
        "all seconds": (1, 0.051),
    }
    for name, row in rows:
        assert len(runs[name]) == 10
        for cell, (column, (unit, near)) in zip(
            row.split(" | "), columns.items(), strict=True
        ):
            values = np.array([run[column] for run in runs[name]]) / unit
            printed = [float(each) for each in re.findall(r"[\d.]+", cell)]
            wanted = [np.median(values), values.min(), values.max()]
            assert printed == pytest.approx(wanted, abs=near), (name, column)


def test_learners_are_compared_at_equal_precision():
    (ratio,) = re.findall(
        r"in float32, recurrent PPO trains ([\d.]+) \(.+?\) to ([\d.]+) times",
        " ".join((RESULTS / "speed.md").read_text("utf-8").split()),
    )
    for file in ("README.md", "docs/results/README.md"):
        text = " ".join((ROOT / file).read_text("utf-8").split())
        claims = re.findall(
            r"PPO(?: trains)? ([\d.]+) to ([\d.]+) times[^|.]+float32", text
        )
        assert claims == [ratio], file
        assert "as fast as sb3-contrib's" in text


def test_the_paper_is_quoted_on_itself_in_one_place():
    for quoted in (
        "narrows",
        "does not change throughout",
        "learning rate decay mechanism",
    ):
        files = [
            path
            for path in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
            if "_build" not in path.parts and quoted in path.read_text("utf-8")
        ]
        assert files in ([], [ROOT / "docs" / "reference" / "paper.md"]), quoted
