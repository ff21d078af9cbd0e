"""Page `docs/results/answer-fusions.md` on the places where knowledge enters the policy."""

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from knowarm.report.collect import collect
from knowarm.report.model import Group, TaskData
from knowarm.statistics import holm, welch
from scripts.answer_cells import FEWEST

SPLIT = "S1"
ALGORITHMS = {"distil": "imitation", "fast": "reinforcement"}
FUSIONS = ("before_fc", "before_lstm", "after_lstm", "attention", "film", "similarity")

TEXT = """**Protocol.** Study `fusions`, IRB120, task `choose`: the subgraph of the query enters
the policy by one of six [fusions](../reference/algorithms.md#policy) (`before_lstm` is the
paper's), without a grounding network. Imitation (300,000 steps) and reinforcement (2 million),
1,000 new episodes of {split}, 5 cm and 15 degrees. *Position*: no arm, the network predicts where
the queried object stands (`python -m benchmarks.fusions`; 60,000 images: seed 0). Last rows: study
`choose`. {progress} Right objects of training seeds {seeds} in percent; at random {chance:.0f}:"""


def shares(values: Iterable[float]) -> str:
    """Format one share per training seed, in percent."""
    return ", ".join(f"{100 * value:.1f}" for value in values)


def found_on(task: TaskData, split: str) -> dict[str, Group]:
    """Return the agents of a task with episodes of a split, by name."""
    return {each.agent: each for each in task.splits.get(split, [])}


def conclusion(how: str, right: Mapping[str, np.ndarray]) -> str:
    """Compare the best fusion with the others, by right choices over training seeds."""
    usable = {name: values for name, values in right.items() if len(values) >= FEWEST}
    best = max(usable, key=lambda name: float(usable[name].mean()))
    others = [name for name in usable if name != best]
    adjusted = holm([welch(usable[best], usable[name]).p_value for name in others])
    beaten = [name for name, p in zip(others, adjusted, strict=True) if p < 0.05]
    names = (
        "every other fusion"
        if len(beaten) == len(others)
        else ", ".join(map(code, beaten))
    )
    text = f"- By {how}, {code(best)} is right most often, in {100 * usable[best].mean():.1f} %"
    text += f", significantly more often than {names}" if beaten else ""
    return text + "."


def code(name: str) -> str:
    """Format a fusion."""
    return f"`{name}`"


def fusions_section(
    study: Path, choose: Path, positions: Path, blind: Path, progress: str
) -> list[str]:
    """Return the blocks of the page from two unpacked studies and two CSV files of shares."""
    known = found_on(collect([choose]).tasks[0], SPLIT)
    grounded, chance = known["subgraph"], known["subgraph"].chance
    tasks = {task.runs[0].config.learner: task for task in collect([study]).tasks}
    columns = ["fusion"]
    rows = [[code(fusion)] for fusion in FUSIONS]
    others = {"`bm` (no query)": known["bm"], "grounding network": grounded}
    last = [[name] for name in others]
    conclusions = []
    best: list[float] = []
    for images, found in positions_of(positions).items():
        columns.append(f"position, {images // 1000},000 images")
        for row, fusion in zip(rows, FUSIONS, strict=True):
            row.append(shares(found.get(fusion, [])))
        for row in last:
            row.append("")
        right = {name: np.array(values) for name, values in found.items()}
        if any(len(values) >= FEWEST for values in right.values()):
            conclusions.append(conclusion(f"position from {images:,} images", right))
    for algorithm, how in ALGORITHMS.items():
        agents = found_on(tasks[algorithm], SPLIT)
        by_fusion = {
            name: agents.get(f"subgraph-{name.replace('_', '-')}") for name in FUSIONS
        }
        columns.append(how)
        for row, each in zip(rows, by_fusion.values(), strict=True):
            row.append(shares(each.scores("choice")) if each else "")
        for row, each in zip(last, others.values(), strict=True):
            row.append(shares(each.scores("choice")) if algorithm == "fast" else "")
        right = {
            name: each.scores("choice") for name, each in by_fusion.items() if each
        }
        conclusions.append(conclusion(how, right))
        best += [float(values.mean()) for values in right.values()]
    lines = [f"| {' | '.join(cells)} |" for cells in (columns, *rows, *last)]
    seeds = sorted({run.config.seed for task in tasks.values() for run in task.runs})
    text = TEXT.format(
        seeds=", ".join(map(str, seeds)),
        split=SPLIT,
        chance=100 * chance,
        progress=progress,
    )
    table = "\n".join([lines[0], "|---" * len(columns) + "|", *lines[1:]])
    conclusions.append(blind_scores(blind))
    lead = (
        f"**With no fusion does the arm choose right in more than {100 * max(best):.1f} % of the "
        f"episodes, with a grounding network in {100 * grounded.scores('choice').mean():.1f} %.**"
    )
    return [
        "# Where the knowledge enters",
        lead,
        text,
        table,
        "\n".join(conclusions),
    ]


def blind_scores(path: Path) -> str:
    """Describe the success of agents that cannot see, on seed 0 of every fusion."""
    rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
    best = {
        name: max(
            float(row["success_percent"]) for row in rows if row["blind_agent"] == name
        )
        for name in ("open-loop", "blind", "frozen")
    }
    return (
        f"- Blind, {rows[0]['episodes']} episodes, seed 0: the best list of actions succeeds in "
        f"{best['open-loop']:.1f} %, the networks on black images in at most {best['blind']:.1f}, "
        f"on the first image only in {best['frozen']:.1f} %."
    )


def positions_of(path: Path) -> dict[int, dict[str, list[float]]]:
    """Read the shares of right positions by number of images and by fusion, one per seed."""
    found: dict[int, dict[str, list[float]]] = {}
    for line in csv.DictReader(path.read_text(encoding="utf-8").splitlines()):
        shares_of = found.setdefault(int(line["images"]), {})
        shares_of.setdefault(line["fusion"], []).append(
            float(line["right_percent"]) / 100
        )
    return found
