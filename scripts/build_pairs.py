"""Builds `docs/results/minimal-pairs.md`, its CSV file and its figure from runs.

    python -m scripts.build_pairs [STUDY OR RUN FOLDERS...]

With folders it collects their evaluations with minimal pairs in the CSV file first: one line per
minimal pair. Page and figure follow from that file alone. Outcomes are fixed in
src/knowarm/study/shipped/minimal-pairs.toml.
"""

import argparse
import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from knowarm.experiment.minimal_pairs import OUTCOMES, VERSIONS, outcomes
from knowarm.experiment.summary import Summary, read_table
from knowarm.statistics import Interval, bootstrap, holm, mean_of_runs, welch, wilson
from knowarm.study.config import StudyConfig, read_study
from scripts.build_answer import wrapped
from scripts.figures import dots, dots_box, picture

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "results" / "minimal-pairs.md"
FIGURE = ROOT / "docs" / "images" / "minimal-pairs.svg"
STUDIES = ("minimal-pairs", "minimal-pairs-answers")
BASELINE = "irb120-choose-bm-distil"
CHOSEN = tuple(f"chosen_{name}" for name in VERSIONS)
TEXTS = ("fact_kind", "fact", "target", "new_answer", "told_answer", *CHOSEN)
COLUMNS = ("experiment", "test", "seed", "episode", *TEXTS)
SHARES = {name.removeprefix("pair_").replace("_", " "): name for name in OUTCOMES}
"""Columns of the table, and the outcomes of which they are the shares."""
KINDS = {"flips, shown": "shown", "flips, not shown": "not shown"}
"""Strata of the flips."""
TESTS = {
    "stop": "it stays unless exactly one visible object answers.",
    "colours": "it knows the colours of the query alone, not the graph.",
    "graph-shuffled": "it answers by a graph with permuted tails.",
}
"""Tests under which an agent that answers by the graph is played as well."""
PREFIX = "post-training-greedy-s1"
"""What names of all evaluations of the study begin with."""

PROTOCOL = """**Protocol.** Every episode is played in five versions with the same image and
question; the agent is told the true graph; a graph in which the fact that decides is another
visible object's (*flips*: it ends there); one in which a triple of the same relation and value
moved between objects out of sight, as like those two in their number of triples as there are
(*false flips*: it ends elsewhere than by the true graph); one without the fact (*stays*: no joint
is ever moved); or the question of another visible object (*follows*: it ends there). *Acts*: right,
flips, and is right after the placebo edit. An agent that takes one of four objects at random flips
in 25 % and acts in 1.6 %. *Shown* are facts on shape and parts, *not shown* those on use, material,
place and content. Suite `choose-v1`, split S1, of which those episodes count whose question allows
all edits; 5 cm and 15 degrees. Fixed before any run:
`src/knowarm/study/shipped/minimal-pairs.toml`. Data: `minimal-pairs.csv`, a line per pair."""


@dataclass(frozen=True)
class Run:
    """The minimal pairs of one trained network under one test: columns (n,)."""

    experiment: str
    test: str
    seed: int
    columns: Mapping[str, np.ndarray]

    def share(self, outcome: str, kind: str = "") -> Interval | None:
        """Return the share of an outcome, of facts of a kind; None where nothing counts."""
        found = outcomes(self.columns, self.columns["target"])
        counts = found["has_foreign" if outcome == "follows" else "has_pair"]
        if kind:
            counts = counts & (self.columns["fact_kind"] == kind)
        if not counts.any():
            return None
        values = found[outcome][counts]
        return wilson(int(values.sum()), len(values))


Arms = dict[tuple[str, str], list[Run]]
"""Runs by experiment and test."""


def evaluations(folders: Sequence[Path]) -> Iterator[Path]:
    """Yield the folders of evaluations with minimal pairs."""
    for folder in folders:
        for summary in sorted(folder.glob("**/evaluation/*pairs*/summary.json")):
            yield summary.parent


def collect(folders: Sequence[Path], out: Path) -> None:
    """Write the minimal pairs of all evaluations to a CSV file."""
    with out.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        for folder in evaluations(folders):
            summary = Summary.read(folder)
            experiment, _, seed = summary.agent.rpartition("/")
            test = summary.label.removeprefix(PREFIX).removesuffix("pairs").strip("-")
            episodes = read_table(folder / "episodes.parquet")
            for row in np.flatnonzero(episodes["has_pair"]).tolist():
                texts = [episodes[name][row] for name in TEXTS]
                rows.writerow([experiment, test, seed, row, *texts])


def read_arms(path: Path) -> Arms:
    """Read the runs by experiment and test."""
    lines: dict[tuple[str, str, int], list[dict[str, str]]] = {}
    with path.open(encoding="utf-8", newline="") as file:
        for line in csv.DictReader(file):
            key = (line["experiment"], line["test"], int(line["seed"]))
            lines.setdefault(key, []).append(line)
    arms: Arms = {}
    for (experiment, test, seed), of_run in lines.items():
        columns = {name: np.array([line[name] for line in of_run]) for name in TEXTS}
        run = Run(experiment, test, seed, columns)
        arms.setdefault((experiment, test), []).append(run)
    return arms


def mean(runs: Sequence[Run], outcome: str, kind: str = "") -> Interval | None:
    """Return the mean of a share over training seeds; of one network, its own interval."""
    shares = [run.share(outcome, kind) for run in runs]
    known = [share for share in shares if share is not None]
    if not known:
        return None
    return known[0] if len(known) == 1 else mean_of_runs(known)


def percent(share: Interval | None) -> str:
    """Format a share with its interval."""
    if share is None:
        return ""
    low, high = 100 * share.low, 100 * share.high
    return f"{100 * share.estimate:.1f} [{low:.1f}, {high:.1f}]"


def name_of(experiment: str, test: str) -> str:
    """Return the name of an arm."""
    return f"`{experiment}`" + (f", {test}" if test else "")


def table(arms: Arms) -> str:
    """Return the table: a row per arm."""
    titles = ["arm", "networks", "pairs", *SHARES, *KINDS]
    lines = [titles]
    for (experiment, test), runs in arms.items():
        pairs = len(runs[0].columns["target"])
        cells = [name_of(experiment, test), str(len(runs)), str(pairs)]
        cells += [percent(mean(runs, outcome)) for outcome in SHARES.values()]
        cells += [percent(mean(runs, "flips", kind)) for kind in KINDS.values()]
        lines.append(cells)
    first, *rest = [f"| {' | '.join(cells)} |" for cells in lines]
    return "\n".join([first, "|---" * len(titles) + "|", *rest])


def planned(studies: Sequence[StudyConfig]) -> dict[tuple[str, str], set[int]]:
    """Return the declared training seeds of every arm."""
    seeds: dict[tuple[str, str], set[int]] = {}
    for study in studies:
        for evaluation in study.evaluations:
            test = evaluation.folder.removeprefix(PREFIX).removesuffix("pairs")
            for experiment in study.cells():
                seeds[experiment, test.strip("-")] = set(study.seeds)
    return seeds


def progress(arms: Arms, seeds: Mapping[tuple[str, str], set[int]]) -> str:
    """Return how much of the studies is done, and what misses."""
    done = {key: {run.seed for run in arms.get(key, [])} & seeds[key] for key in seeds}
    count = sum(map(len, done.values()))
    total = sum(map(len, seeds.values()))
    text = f"**Studies `{'` and `'.join(STUDIES)}`**: {count} of {total} evaluations are there"
    if count == total:
        return f"{text}. None failed."
    missing = sum(len(done[key]) < len(seeds[key]) for key in seeds)
    state = "begun" if count else "not begun"
    return (
        f"{text}: {state}. Training seeds miss in {missing} of {len(seeds)} arms, of which nothing "
        "is said before they are there."
    )


def verdicts(arms: Arms, seeds: Mapping[tuple[str, str], set[int]]) -> list[str]:
    """Return the sentence on each arm whose training seeds are all there."""
    complete = {}
    for key, planned_seeds in seeds.items():
        if {run.seed for run in arms.get(key, [])} == planned_seeds:
            complete[key] = arms[key]
    if (BASELINE, "") not in complete:
        return []
    flips = {key: _values(runs, "flips") for key, runs in complete.items()}
    others = [key for key in complete if key != (BASELINE, "")]
    compared = [welch(flips[key], flips[BASELINE, ""]) for key in others]
    adjusted = holm([each.p_value for each in compared])
    lines = []
    for key, against, p in zip(others, compared, adjusted.tolist(), strict=True):
        false = _values(complete[key], "false_flips")
        apart = bootstrap(flips[key] - false)
        acts = against.difference.low > 0 and p < 0.05 and apart.low > 0
        verdict = "acts on the fact" if acts else "is not shown to act on the fact"
        lines.append(
            f"- {name_of(*key)} {verdict}: flips {percent(against.difference)} points above "
            f"`bm` (p {p:.3f}), {percent(apart)} above its false flips."
        )
    return lines


def _values(runs: Sequence[Run], outcome: str) -> np.ndarray:
    shares = [run.share(outcome) for run in runs]
    return np.array([share.estimate for share in shares if share is not None])


def lead(arms: Arms) -> str:
    """Return the page's first sentence: on the arm with most flips, and the one with fewest."""
    rates = {key: _values(runs, "flips").mean() for key, runs in arms.items()}
    most = max(rates, key=lambda key: rates[key])
    least = min(rates, key=lambda key: rates[key])
    return (
        f"**When one fact is edited, {name_of(*most)} goes to the new answer in "
        f"{100 * rates[most]:.0f} % of the episodes, {name_of(*least)} in "
        f"{100 * rates[least]:.0f} %; when a fact is edited that does not decide, they end "
        f"elsewhere in {100 * _values(arms[most], 'false_flips').mean():.0f} and "
        f"{100 * _values(arms[least], 'false_flips').mean():.0f} %.**"
    )


def tests_in(arms: Arms) -> str:
    """Explain the tests that arms were played under."""
    played = dict.fromkeys(test for _, test in arms if test)
    return " ".join(f"*{test}*: {TESTS[test]}" for test in played)


def page(arms: Arms, seeds: Mapping[tuple[str, str], set[int]]) -> str:
    """Return the text of the page."""
    study = {key: runs for key, runs in arms.items() if key in seeds}
    shipped = {key: runs for key, runs in arms.items() if key not in seeds}
    parts = [
        "<!-- Written by scripts/build_pairs.py; do not edit. -->\n# Does it act on the fact?",
        lead(arms),
        "![Flips and false flips of every network](../images/minimal-pairs.svg)",
        PROTOCOL,
    ]
    if shipped:
        parts += [
            "**Shipped policies**, one network each, percent with intervals over episodes: what "
            f"these networks do, no claim on a way to train them. {tests_in(shipped)}",
            table(shipped),
        ]
    parts.append(progress(arms, seeds))
    if study:
        parts.append(tests_in(study))
        parts.append(table(study))
        parts.append("\n".join(verdicts(arms, seeds)))
    return "\n\n".join(wrapped(part) for part in parts if part) + "\n"


def figure(arms: Arms) -> str:
    """Draw flips and false flips: a dot per network."""
    rows = {}
    for (experiment, test), runs in arms.items():
        name = f"{experiment}, {test}" if test else experiment
        flips = _values(runs, "flips").tolist()
        false = _values(runs, "false_flips").tolist()
        rows[name] = {"c-blue": flips, "c-orange": false}
    chart = dots(rows, "Flips and false flips by arm", "ends at another object")
    legend = {"flips": "c-blue", "false flips": "c-orange"}
    return picture([chart], dots_box(rows), legend)


def main() -> None:
    """Collect evaluations, if folders are given, and write page and figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="*")
    parser.add_argument("--out", type=Path, default=PAGE)
    parser.add_argument("--figure", type=Path, default=FIGURE)
    given = parser.parse_args()
    data = PAGE.with_suffix(".csv")
    if given.folders:
        collect(given.folders, data)
    arms = read_arms(data)
    given.figure.write_text(figure(arms), encoding="utf-8")
    text = page(arms, planned([read_study(name) for name in STUDIES]))
    given.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
