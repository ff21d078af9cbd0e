"""Prints the tables of docs/results/answers.md whose intervals cover what is held out as well.

    python -m scripts.hold_outs    # from the packs there

An interval is over training seeds and over what the episodes of a split are about: see `TOPICS`.
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from knowarm.experiment.summary import read_table
from knowarm.statistics import Interval, crossed_bootstrap
from knowarm.study.pack import unpack_study

RESULTS = Path(__file__).parents[1] / "docs" / "results"
TABLES = {
    "answers": ("choose-answers-fast", ("s1", "s2", "s3", "s4", "s5")),
    "families": ("families-answers-distil", ("s1", "s2", "s3a", "s3b", "s4", "s5")),
}
"""Experiment, but for its robot, and splits of each pack."""
ROBOTS = {"IRB120": "irb120", "TIAGo": "tiago"}
MEASURES = {"right": "choice_correct", "success": "success"}
TOPICS = {
    "s3": "objects",
    "s3a": "instances",
    "s3b": "kinds",
    "s4": "values",
}
"""What is held out in a split; in the others queries are."""


def topic_of(split: str, query: str, target: str) -> str:
    """Return what an episode is about: the draw of a split's hold-outs is a draw of these."""
    if split in ("s3", "s3a"):
        return target
    if split == "s3b":
        kind, _, _ = target.rpartition("-")
        return kind
    if split == "s4":
        value, _, _ = query.partition(" and hasColor ")
        return value
    return query


def intervals(experiment: Path, split: str) -> tuple[dict[str, Interval], set[str]]:
    """Return the interval of every measure, and the topics, of a split's episodes."""
    runs: list[str] = []
    topics: list[str] = []
    scores: dict[str, list[float]] = {name: [] for name in MEASURES}
    for path in sorted(experiment.glob(f"*/evaluation/*-{split}/episodes.parquet")):
        episodes = read_table(path)
        seed = path.parents[2].name
        for query, target in zip(episodes["query"], episodes["target"], strict=True):
            topics.append(topic_of(split, query, target))
            runs.append(seed)
        for name, column in MEASURES.items():
            scores[name] += episodes[column].astype(float).tolist()
    of_measures = {
        name: crossed_bootstrap(np.array(values), runs, topics)
        for name, values in scores.items()
    }
    return of_measures, set(topics)


def table(study: Path, experiment: str, splits: Sequence[str]) -> str:
    """Return a table in Markdown: two rows per robot, topics, a column per split."""
    lines = []
    topics: dict[str, set[str]] = {split: set() for split in splits}
    for title, robot in ROBOTS.items():
        of_splits = []
        for split in splits:
            runs = study / f"{robot}-{experiment}"
            of_measures, topics_of_robot = intervals(runs, split)
            of_splits.append(of_measures)
            topics[split] |= topics_of_robot
        for measure in MEASURES:
            cells = []
            for of_measures in of_splits:
                share = of_measures[measure]
                cells.append(
                    f"{100 * share.estimate:.1f} [{100 * share.low:.1f}, {100 * share.high:.1f}]"
                )
            first = f"| {title} " if measure == "right" else "| "
            lines.append(f"{first}| {measure} | {' | '.join(cells)} |")
    counts = [
        f"{len(names)} {TOPICS.get(split, 'queries')}"
        for split, names in topics.items()
    ]
    lines.append(f"| | | {' | '.join(counts)} |")
    return "\n".join(lines)


def main() -> None:
    """Print the tables."""
    for pack, (experiment, splits) in TABLES.items():
        with tempfile.TemporaryDirectory() as folder:
            study = unpack_study(RESULTS / f"{pack}.tar.xz", Path(folder) / pack)
            print(table(study, experiment, splits))


if __name__ == "__main__":
    main()
