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
from knowarm.statistics import (
    CrossedScores,
    Interval,
    bootstrap,
    crossed_mean,
    holm,
    mean_of_runs,
    paired,
    share_difference,
    wilson,
)
from knowarm.study.config import StudyConfig, read_study
from scripts.build_answer import wrapped
from scripts.figures import dots, dots_box, picture

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "results" / "minimal-pairs.md"
FIGURE = ROOT / "docs" / "images" / "minimal-pairs.svg"
STUDIES = ("minimal-pairs", "minimal-pairs-answers")
CLONE = "irb120-choose-subgraph-sb3-clone"
"""Arm of a neighbour's architecture, which `scripts/clone_pairs.py` trains and tests."""
CHOSEN = tuple(f"chosen_{name}" for name in VERSIONS)
TEXTS = ("fact_kind", "fact", "target", "new_answer", "told_answer", *CHOSEN)
COLUMNS = ("experiment", "test", "seed", "episode", *TEXTS)
MOVED = "moved"
"""Column of the primary outcome: points, not a share."""
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

PROTOCOL = """**Protocol.** Every episode is played by the true graph and in [four other
versions](../reference/choose.md#minimal-pairs): deciding edit (*flips*: it ends at the new answer),
placebo edit, of degrees as similar as possible (*false flips*: it ends elsewhere than by the true
graph), removal (*stays*: no joint is ever moved), foreign question (*follows*: it ends at its
object). *Moved*: flips, less the ends at the same object after the placebo edit [points]; 0 for an
agent that does not read the fact. *Acts*: right, flips, and is right after the placebo edit.
*Shown* are facts on shape and parts, *not shown* those on use, material,
place and content. Suite `choose-v1`, split S1, only episodes whose question allows all edits; 5 cm
and 15 degrees. Fixed before any run:
`src/knowarm/study/shipped/minimal-pairs.toml`. Data: `minimal-pairs.csv`."""


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

    def moves(self) -> np.ndarray:
        """Return of every pair, (n,): 1 moved by the deciding edit, -1 by the placebo, else 0."""
        new = self.columns["new_answer"]
        deciding, placebo = (
            (self.columns[f"chosen_{name}"] == new).astype(float)
            for name in ("deciding", "placebo")
        )
        return deciding - placebo

    def moved(self) -> Interval:
        """Return the flips less the share that ends there after the placebo edit."""
        new = self.columns["new_answer"]
        deciding, placebo = (
            wilson(int((self.columns[f"chosen_{name}"] == new).sum()), len(new))
            for name in ("deciding", "placebo")
        )
        return share_difference(deciding, placebo)


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
        columns = {
            name: np.array([line[name] for line in of_run])
            for name in (*TEXTS, "episode")
        }
        run = Run(experiment, test, seed, columns)
        arms.setdefault((experiment, test), []).append(run)
    return arms


def mean(shares: Sequence[Interval | None]) -> Interval | None:
    """Return the mean over training seeds; of one network, its own interval."""
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
    titles = ["arm", "networks", "pairs", MOVED, *SHARES, *KINDS]
    lines = [titles]
    for (experiment, test), runs in arms.items():
        pairs = len(runs[0].columns["target"])
        cells = [name_of(experiment, test), str(len(runs)), str(pairs)]
        shares: list[list[Interval | None]] = [[run.moved() for run in runs]]
        shares += [[run.share(each) for run in runs] for each in SHARES.values()]
        shares += [
            [run.share("flips", kind) for run in runs] for kind in KINDS.values()
        ]
        cells += [percent(mean(of_runs)) for of_runs in shares]
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
    first, *_ = studies
    return {**seeds, (CLONE, ""): set(first.seeds)}


def progress(arms: Arms, seeds: Mapping[tuple[str, str], set[int]]) -> str:
    """Return how much of the studies is done, and what misses."""
    done = {key: {run.seed for run in arms.get(key, [])} & seeds[key] for key in seeds}
    count = sum(map(len, done.values()))
    total = sum(map(len, seeds.values()))
    text = f"**Studies `{'` and `'.join(STUDIES)}`**: {count} of {total} evaluations are there"
    if count == total:
        return f"{text}. None failed."
    if count == 0:
        return f"{text}: not begun."
    missing = sum(len(done[key]) < len(seeds[key]) for key in seeds)
    return (
        f"{text}: begun. Training seeds miss in {missing} of {len(seeds)} arms; until then the "
        "table has the seeds that all begun arms have, and there is no verdict."
    )


def shown(arms: Arms, seeds: Mapping[tuple[str, str], set[int]]) -> Arms:
    """Return the arms of the studies; unless all are complete, with their common seeds."""
    begun = {key: arms[key] for key in seeds if key in arms}
    by_arm = {key: {run.seed for run in runs} for key, runs in begun.items()}
    if by_arm == dict(seeds) or not begun:
        return begun
    common = set.intersection(*by_arm.values())
    kept = {
        key: [run for run in runs if run.seed in common] for key, runs in begun.items()
    }
    return kept if common else {}


def verdicts(arms: Arms, seeds: Mapping[tuple[str, str], set[int]]) -> list[str]:
    """Return the sentence on each arm; none before all training seeds are there."""
    for key, planned_seeds in seeds.items():
        if {run.seed for run in arms.get(key, [])} != planned_seeds:
            return []
    compared = []
    for key in seeds:
        moved = np.array([run.moved().estimate for run in arms[key]])
        compared.append(paired(moved, np.zeros_like(moved)))
    adjusted = holm([each.p_value for each in compared])
    lines = []
    for key, of_zero, p in zip(seeds, compared, adjusted.tolist(), strict=True):
        false = _values(arms[key], "false_flips")
        apart = bootstrap(_values(arms[key], "flips") - false)
        both = over_seeds_and_facts(arms[key])
        is_moved = of_zero.difference.low > 0 and p < 0.05 and both.low > 0
        acts = is_moved and apart.low > 0
        verdict = "acts on the fact" if acts else "is not shown to act on the fact"
        lines.append(
            f"- {name_of(*key)} {verdict}: moved by {percent(of_zero.difference)} points (p "
            f"{p:.3f}; over seeds and facts {percent(both)}), flips {percent(apart)} points above "
            "its false flips."
        )
    return lines


def over_seeds_and_facts(runs: Sequence[Run]) -> Interval:
    """Return `Run.moved` with an interval over training seeds and the edited facts at once."""
    moves = np.concatenate([run.moves() for run in runs])
    facts = np.concatenate([run.columns["fact"] for run in runs])
    seeds = np.repeat([run.seed for run in runs], [len(run.moves()) for run in runs])
    return crossed_mean(CrossedScores(moves, seeds, facts))


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


def episodes(arms: Arms) -> int:
    """Return among how many episodes of the suite the pairs of some arms lie."""
    numbers = [run.columns["episode"] for runs in arms.values() for run in runs]
    return 1 + max(map(int, np.concatenate(numbers)))


def page(arms: Arms, seeds: Mapping[tuple[str, str], set[int]]) -> str:
    """Return the text of the page."""
    study = shown(arms, seeds)
    shipped = {key: runs for key, runs in arms.items() if key not in seeds}
    parts = [
        "<!-- Written by scripts/build_pairs.py; do not edit. -->\n# Does it act on the fact?",
        lead(arms),
        "![Flips and false flips of every network](../images/minimal-pairs.svg)",
        PROTOCOL,
    ]
    if shipped:
        parts += [
            f"**Shipped policies**, one network each, the first {episodes(shipped)} episodes, "
            "percent with intervals over episodes: what these networks do, no claim on a way to "
            f"train them. {tests_in(shipped)}",
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
    seeds = planned([read_study(name) for name in STUDIES])
    shipped = {key: runs for key, runs in arms.items() if key not in seeds}
    drawn = figure({**shipped, **shown(arms, seeds)})
    given.figure.write_text(drawn, encoding="utf-8")
    text = page(arms, seeds)
    given.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
