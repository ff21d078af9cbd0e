"""Draw the figures of docs/results from the studies' packs and tables there.

python -m scripts.draw_results    # writes to docs/images
"""

import csv
import tempfile
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from knowarm.report.charts import (
    BOXES,
    CHOICE_AXIS,
    SUCCESS_AXIS,
    Box,
    Series,
    line_chart,
    percent_axis,
)
from knowarm.report.collect import collect
from knowarm.report.pages.training import curve_figure
from knowarm.study.pack import unpack_study
from scripts.figures import dots, dots_box, picture, seed_scores

RESULTS, IMAGES = Path("docs/results"), Path("docs/images")
SPLITS = ("s1", "s2", "s3", "s4", "s5")
FAMILIES = ("s1", "s2", "s3a", "s3b", "s4", "s5")


def choose_curves(study: Path) -> str:
    """Draw how the agents of the study `choose` learned to choose and to reach."""
    (task,) = collect([study]).tasks
    drawings = []
    for key, axis in {"choice": CHOICE_AXIS, "success": SUCCESS_AXIS}.items():
        figure = curve_figure(task, {key: axis}, key, axis.title)
        drawings += [panel.svg for panel in figure.panels if panel.only == "large"]
    legend = {group.name: task.colours[group.name] for group in task.groups}
    return picture(drawings, BOXES["large"], legend)


def learned(study: Path, title: str) -> str:
    """Draw the interim success of the agents of one task of a study."""
    task = next(each for each in collect([study]).tasks if each.title == title)
    figure = curve_figure(task, {"success": SUCCESS_AXIS}, "success", SUCCESS_AXIS.title)
    legend = {group.name: task.colours[group.name] for group in task.groups}
    return picture([figure.panels[0].svg], BOXES["large"], legend)


def reach_success(irb120: Path, tiago: Path) -> str:
    """Draw the success of every run of the paper's cells, from a study for each robot."""
    agents = {"bm": "c-grey", "partial": "c-orange", "full": "c-blue"}
    rows = {
        f"{robot}{colours}": {
            colour: seed_scores(study, f"{robot}-{agent}{colours}-fast", "success").tolist()
            for agent, colour in agents.items()
        }
        for robot, study in (("irb120", irb120), ("tiago", tiago))
        for colours in ("", "-dr")
    }
    name = "success"
    drawing = dots(rows, "Success per training seed of twelve experiments", name, low=0.8)
    return picture([drawing], dots_box(rows), agents)


def answers(study: Path, agent: str, splits: Sequence[str] = SPLITS) -> str:
    """Draw right choices and success of every run of an agent on both robots."""
    measures = {"right choices": ("choice", "c-blue"), "success": ("success", "c-orange")}
    rows = {
        f"{robot}, {split.capitalize()}": {
            colour: seed_scores(study, f"{robot}-{agent}", key, split).tolist()
            for key, colour in measures.values()
        }
        for robot in ("irb120", "tiago")
        for split in splits
    }
    drawing = dots(rows, "Right choices and success per training seed, robot and split", "")
    return picture([drawing], dots_box(rows), {name: c for name, (_, c) in measures.items()})


def damaged_graph(table: Path) -> str:
    """Draw right choices over the damaged share, of the robots and splits of a table."""
    values: dict[tuple[str, str, str], dict[float, list[float]]] = defaultdict(dict)
    with table.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            line = values[row["robot"], row["split"], row["kind"]]
            line.setdefault(float(row["share"]), []).append(float(row["right"]))
    colours = {"missing": "c-blue", "wrong": "c-orange", "adversarial": "c-purple"}
    share = percent_axis("damaged triples", whole=False)
    box, drawings = Box(width=330, height=230), []
    for robot, split in (("irb120", "S1"), ("irb120", "S4"), ("tiago", "S1"), ("tiago", "S4")):
        title = f"right choices, {robot}, {split}"
        lines = [
            Series(
                name=kind,
                colour=colour,
                x=np.array(sorted(values[robot, split, kind])),
                y=np.array([np.mean(v) for _, v in sorted(values[robot, split, kind].items())]),
            )
            for kind, colour in colours.items()
        ]
        drawings.append(line_chart(lines, title, share, percent_axis(title), box=box))
    return picture(drawings, box, colours, columns=2)


FIGURES: dict[str, tuple[Sequence[str], Callable[..., str]]] = {
    "choose-curves.svg": (["choose.tar.xz"], choose_curves),
    "first-agent-curve.svg": (
        ["paper.tar.xz"],
        partial(learned, title="PAL TIAGo · fixed colours · fast"),
    ),
    "a3c-curve.svg": (
        ["a3c-tuned.tar.xz"],
        partial(learned, title="ABB IRB120 · fixed colours · a3c-tuned"),
    ),
    "reach-success.svg": (["answer.tar.xz", "paper.tar.xz"], reach_success),
    "answers.svg": (["answers.tar.xz"], partial(answers, agent="choose-answers-fast")),
    "answers-distil.svg": (
        ["answers-distil.tar.xz"],
        partial(answers, agent="choose-answers-distil"),
    ),
    "families-answers.svg": (
        ["families.tar.xz"],
        partial(answers, agent="families-answers-distil", splits=FAMILIES),
    ),
    "damaged-graph.svg": (["damaged-graph.csv"], damaged_graph),
}
"""Sources in `RESULTS` and function of each figure."""


def main() -> None:
    """Write all figures."""
    for name, (sources, draw) in FIGURES.items():
        with tempfile.TemporaryDirectory() as folder:
            paths = [
                unpack_study(RESULTS / source, Path(folder) / source)
                if source.endswith(".tar.xz")
                else RESULTS / source
                for source in sources
            ]
            (IMAGES / name).write_text(draw(*paths), encoding="utf-8")
        print(f"Wrote {IMAGES / name}")


if __name__ == "__main__":
    main()
