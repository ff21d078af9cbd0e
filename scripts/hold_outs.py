"""Prints the tables of docs/results whose intervals cover what is held out as well.

    python -m scripts.hold_outs    # from the packs there

An interval is over training seeds and over what the episodes of a split are about: see `topic_of`.
Pages: answers.md and grasp.md (levels), choose.md (differences).
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from knowarm.experiment.summary import read_table
from knowarm.knowledge.queries.splits import TOPICS, topic_of
from knowarm.statistics import (
    CrossedScores,
    Interval,
    crossed_difference,
    crossed_share,
)
from knowarm.study.pack import unpack_study

RESULTS = Path(__file__).parents[1] / "docs" / "results"
CHOOSE = ("S1", "S2", "S3", "S4", "S5")
FAMILIES = ("S1", "S2", "S3a", "S3b", "S4", "S5")
PURPOSE = ("S1", "S2", "S4", "S5")
TABLES: dict[str, tuple[dict[str, str], Sequence[str]]] = {
    "answers": (
        {
            "IRB120": "irb120-choose-answers-fast",
            "TIAGo": "tiago-choose-answers-fast",
        },
        CHOOSE,
    ),
    "answers-distil": (
        {
            "IRB120": "irb120-choose-answers-distil",
            "TIAGo": "tiago-choose-answers-distil",
        },
        CHOOSE,
    ),
    "families": (
        {
            "IRB120": "irb120-families-answers-distil",
            "TIAGo": "tiago-families-answers-distil",
        },
        FAMILIES,
    ),
    "purpose": (
        {
            "`answers`": "irb120-purpose-answers-distil",
            "`answers-shuffled`": "irb120-purpose-answers-shuffled-distil",
        },
        PURPOSE,
    ),
}
"""Experiments by the title of their rows, and splits, of each pack."""
CONTROLS = ("query-onehot", "query-words", "subgraph-shuffled")
MEASURES = {"right": "choice_correct", "success": "success"}


def episodes_of(experiment: Path, split: str) -> dict[str, CrossedScores]:
    """Return the episodes of all training seeds in a split, by measure."""
    runs: list[str] = []
    topics: list[str] = []
    scores: dict[str, list[float]] = {name: [] for name in MEASURES}
    for path in sorted(
        experiment.glob(f"*/evaluation/*-{split.lower()}/episodes.parquet")
    ):
        episodes = read_table(path)
        seed = path.parents[2].name
        for query, target in zip(episodes["query"], episodes["target"], strict=True):
            topics.append(topic_of(split, query, target))
            runs.append(seed)
        for name, column in MEASURES.items():
            scores[name] += episodes[column].astype(float).tolist()
    return {
        name: CrossedScores(np.array(values), runs, topics)
        for name, values in scores.items()
    }


def topics_of(scores: CrossedScores) -> set[str]:
    """Return the topics of episodes."""
    return set(np.asarray(scores.topics, str).tolist())


def percent(interval: Interval, sign: str = "") -> str:
    """Return an interval as the cell of a table."""
    ends = (interval.estimate, interval.low, interval.high)
    middle, low, high = (f"{100 * end:{sign}.1f}" for end in ends)
    return f"{middle} [{low}, {high}]"


def last_row(topics: dict[str, set[str]], first: str) -> str:
    """Return the row that counts the topics of every split."""
    counts = [
        f"{len(names)} {TOPICS.get(split, 'queries')}"
        for split, names in topics.items()
    ]
    return f"{first} {' | '.join(counts)} |"


def levels(study: Path, experiments: dict[str, str], splits: Sequence[str]) -> str:
    """Return a table in Markdown: two rows per experiment, topics, a column per split."""
    lines = []
    topics: dict[str, set[str]] = {split: set() for split in splits}
    for title, experiment in experiments.items():
        of_splits = []
        for split in splits:
            of_measures = episodes_of(study / experiment, split)
            of_splits.append(of_measures)
            topics[split] |= topics_of(of_measures["right"])
        for measure in MEASURES:
            cells = [percent(crossed_share(scores[measure])) for scores in of_splits]
            first = f"| {title} " if measure == "right" else "| "
            lines.append(f"{first}| {measure} | {' | '.join(cells)} |")
    lines.append(last_row(topics, "| | |"))
    return "\n".join(lines)


def differences(study: Path) -> str:
    """Return a table in Markdown: by how much `subgraph` exceeds each control in right choices.

    Splits where seeds alone show no advantage are left out.
    """
    splits = ("S2", "S4", "S5")
    subject = [
        episodes_of(study / "irb120-choose-subgraph-fast", split)["right"]
        for split in splits
    ]
    lines = []
    for control in CONTROLS:
        cells = []
        for split, scores in zip(splits, subject, strict=True):
            others = episodes_of(study / f"irb120-choose-{control}-fast", split)
            difference = crossed_difference(scores, others["right"])
            cells.append(percent(difference, "+"))
        lines.append(f"| `{control}` | {' | '.join(cells)} |")
    topics = {
        split: topics_of(scores) for split, scores in zip(splits, subject, strict=True)
    }
    lines.append(last_row(topics, "| |"))
    return "\n".join(lines)


def by_topic(experiment: Path, split: str) -> str:
    """Return the success of every topic of a split in percent."""
    hits = episodes_of(experiment, split)["success"]
    topics = np.array(hits.topics)
    shares = [
        f"{topic} {100 * hits.scores[topics == topic].mean():.0f}"
        for topic in np.unique(topics)
    ]
    return ", ".join(shares)


def main() -> None:
    """Print the tables, and the success of every object and kind that was held out."""
    with tempfile.TemporaryDirectory() as folder:
        for pack, (experiments, splits) in TABLES.items():
            study = unpack_study(RESULTS / f"{pack}.tar.xz", Path(folder) / pack)
            print(levels(study, experiments, splits))
            for split in set(splits) & {"S3", "S3b"}:
                for title, experiment in experiments.items():
                    print(f"{title}: {by_topic(study / experiment, split)}")
        study = unpack_study(RESULTS / "choose.tar.xz", Path(folder) / "choose")
        print(differences(study))


if __name__ == "__main__":
    main()
