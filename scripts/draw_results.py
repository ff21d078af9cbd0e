"""Draw the figures of docs/results from the studies' packs and tables there.

python -m scripts.draw_results    # writes to docs/images
"""

import csv
import json
import math
import re
import tempfile
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from knowarm.experiment.names import experiment_config
from knowarm.report.charts import (
    BOXES,
    CHOICE_AXIS,
    SUCCESS_AXIS,
    Axis,
    Box,
    Series,
    line_chart,
    percent_axis,
)
from knowarm.report.collect import collect
from knowarm.report.pages.training import curve_figure
from knowarm.study.pack import unpack_study
from knowarm.svg import drawing, element, label
from knowarm.world.config import facets_of
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
    legend = {group.name: group.colour for group in task.groups}
    return picture(drawings, BOXES["large"], legend)


def learned(study: Path, title: str) -> str:
    """Draw the interim success of the agents of one task of a study."""
    task = next(each for each in collect([study]).tasks if each.title == title)
    figure = curve_figure(
        task, {"success": SUCCESS_AXIS}, "success", SUCCESS_AXIS.title
    )
    legend = {group.name: group.colour for group in task.groups}
    return picture([figure.panels[0].svg], BOXES["large"], legend)


def reach_success(irb120: Path, tiago: Path, randomized: Path) -> str:
    """Draw the success of every run of the paper's cells that `scripts.build_answer` compares."""
    agents = {"bm": "c-grey", "partial": "c-orange", "full": "c-blue"}
    rows = {
        f"{robot}{colours}": {
            colour: seed_scores(
                study, f"{robot}-{agent}{colours}-fast", "success"
            ).tolist()
            for agent, colour in agents.items()
        }
        for robot, colours, study in (
            ("irb120", "", irb120),
            ("irb120", "-dr", irb120),
            ("tiago", "", tiago),
            ("tiago", "-dr", randomized),
        )
    }
    name = "success"
    chart = dots(
        rows, "Success per training seed of the paper's experiments", name, low=0.8
    )
    return picture([chart], dots_box(rows), agents)


def answers(study: Path, agent: str, splits: Sequence[str] = SPLITS) -> str:
    """Draw right choices and success of every run of an agent on both robots."""
    measures = {
        "right choices": ("choice", "c-blue"),
        "success": ("success", "c-orange"),
    }
    rows = {
        f"{robot}, {split.capitalize()}": {
            colour: seed_scores(study, f"{robot}-{agent}", key, split).tolist()
            for key, colour in measures.values()
        }
        for robot in ("irb120", "tiago")
        for split in splits
    }
    chart = dots(
        rows, "Right choices and success per training seed, robot and split", ""
    )
    return picture(
        [chart], dots_box(rows), {name: c for name, (_, c) in measures.items()}
    )


KINDS = {each: (each, f"c-{c}") for each, c in
         (("missing", "blue"), ("wrong", "orange"), ("adversarial", "purple"))}  # fmt: skip
CONFIDENCE = {"": ("unknown", "c-orange"), "0.75": ("AUC .75", "c-blue"),
              "0.9": ("AUC .9", "c-purple"), "1.0": ("known exactly", "c-teal")}  # fmt: skip


def damaged_graph(
    table: Path,
    column: str = "kind",
    lines: Mapping[str, tuple[str, str]] = KINDS,
    kinds: Collection[str] = tuple(KINDS),
) -> str:
    """Draw right choices over the damaged share, of the robots and splits of a table.

    Args:
        table: the file.
        column: a line per value of this column.
        lines: name and colour of the line by value.
        kinds: kinds of damage that count.
    """
    values: dict[tuple[str, str, str], dict[float, list[float]]] = defaultdict(dict)
    with table.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            if row["kind"] in kinds:
                line = values[row["robot"], row["split"], row[column]]
                line.setdefault(float(row["share"]), []).append(float(row["right"]))
    share = percent_axis("damaged triples", whole=False)
    box, drawings = Box(width=330, height=230), []
    for robot, split in (
        ("irb120", "S1"),
        ("irb120", "S4"),
        ("tiago", "S1"),
        ("tiago", "S4"),
    ):
        title = f"right choices, {robot}, {split}"
        drawn = [
            Series(
                name=name,
                colour=colour,
                x=np.array(sorted(values[robot, split, each])),
                y=np.array(
                    [np.mean(v) for _, v in sorted(values[robot, split, each].items())]
                ),
            )
            for each, (name, colour) in lines.items()
        ]
        drawings.append(line_chart(drawn, title, share, percent_axis(title), box=box))
    return picture(drawings, box, dict(lines.values()), columns=2)


def table(page: Path, number: int) -> list[list[str]]:
    """Return the cells of a page's table, without the row of dashes; tables count from 0."""
    tables: list[list[list[str]]] = [[]]
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("|"):
            tables[-1].append(
                [cell.strip(" *`") for cell in line.strip("| ").split(" | ")]
            )
        elif tables[-1]:
            tables.append([])
    return [row for row in tables[number] if not set(row[0]) <= set("-|")]


def numbers(cell: str) -> list[float]:
    """Return the shares of a cell in per cent, such as "98.7 [98.0, 100.0] %", as fractions."""
    return [float(found) / 100 for found in re.findall(r"\d*\.?\d+", cell)]


def intervals(page: Path, number: int, name: str) -> str:
    """Draw success with its interval: rows of a table, whose columns are the legend."""
    (_, *columns), *rows = table(page, number)
    colours = dict(zip(columns, ("c-blue", "c-orange"), strict=True))
    found = {
        row: dict(zip(colours.values(), map(numbers, cells), strict=True))
        for row, *cells in rows
    }
    values = {row: {c: v[:1] for c, v in each.items()} for row, each in found.items()}
    spans = {
        row: {c: (v[1], v[2]) for c, v in each.items()} for row, each in found.items()
    }
    return picture(
        [dots(values, name, "success", spans=spans)], dots_box(values), colours
    )


def vision(page: Path) -> str:
    """Draw the success of trained agents, and of those that do not see."""
    (_, _, *thresholds), *lines = table(page, 0)
    agents = {
        "trained": ("full", "c-blue"),
        "fixed actions": ("open-loop", "c-orange"),
        "black images": ("blind", "c-grey"),
    }
    rows: dict[str, dict[str, list[float]]] = {}
    for robot in ("irb120", "tiago"):
        for column, threshold in enumerate(thresholds, start=2):
            rows[f"{robot}, {threshold}"] = {
                colour: [
                    numbers(line[column])[0]
                    for line in lines
                    if line[0] == robot and line[1].startswith(start)
                ]
                for start, colour in agents.values()
            }
    chart = dots(rows, "Success of agents that see and that do not", "success")
    return picture(
        [chart], dots_box(rows), {name: c for name, (_, c) in agents.items()}
    )


def reasoning(page: Path) -> str:
    """Draw right objects per split, by what tells the network which object is meant."""
    names = {
        "query's vector": "c-grey",
        "graph answers": "c-blue",
        "shuffled answers": "c-orange",
        "colours only": "c-purple",
    }
    (_, *splits), *lines = table(page, 2)
    rows = {
        split: {
            colour: numbers(cells[i])[:1]
            for colour, (_, *cells) in zip(names.values(), lines, strict=True)
        }
        for i, split in enumerate(splits)
    }
    return picture(
        [dots(rows, "Right objects per split", "right object")], dots_box(rows), names
    )


def speed(measured: Path) -> str:
    """Draw environment steps per second of three renderers, on a logarithmic axis."""
    kinds = {
        "KnowArm": ("steps_per_s", "c-blue"),
        "MuJoCo Warp, CPU": ("mjwarp_steps_per_s", "c-orange"),
        "AsyncVectorEnv, OpenGL": ("opengl_steps_per_s", "c-grey"),
    }
    rows = {
        f"{row['robot']}, {row['dynamics']}": {
            colour: [math.log10(row[key])] for key, colour in kinds.values()
        }
        for row in json.loads(measured.read_text(encoding="utf-8"))["rows"]
    }
    title = "environment steps per second, logarithmic"
    axis = Axis(
        title=title, format=lambda value, _: f"{10**value:,.0f}", range=(2.0, 5.6)
    )
    legend = {name: colour for name, (_, colour) in kinds.items()}
    return picture(
        [dots(rows, f"Simulation with images: {title}", axis)], dots_box(rows), legend
    )


def cosines() -> str:
    """Draw the cosines of the knowledge vectors of the reach task, of `full` and `full+`."""
    agents = {"full": "target", "full+": "target+"}  # the same vectors, of each facet
    side, left, drawings = 46, 164, []
    for name, agent in agents.items():
        config = experiment_config(f"irb120-{agent}-dr-fast")
        vectors = config.knows.known(config.env, config.seed).table
        unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        facets = ["/".join(facet) for facet in facets_of(config.env)]
        parts = []
        for i, row in enumerate(unit @ unit.T):
            y = 30 + side * i
            parts.append(
                label(left - 8, y + 28, facets[i], class_="row-name", text_anchor="end")
            )
            for j, cosine in enumerate(row):
                at = {
                    "x": left + side * j,
                    "y": y,
                    "width": side - 2,
                    "height": side - 2,
                }
                shade = max(0.0, float(cosine)) ** 2
                parts.append(element("rect", **at, fill="var(--c)", fill_opacity=shade))
                middle = {"class_": "tick", "text_anchor": "middle"}
                words = f"{cosine:.3f}".replace("0.", ".", 1)
                style = "fill: #ffffff !important" if shade > 0.35 else None
                parts.append(label(at["x"] + 22, y + 27, words, style=style, **middle))
        height = 40 + side * len(facets)
        title = f"Cosines of the vectors of {name}"
        width = left + side * len(facets) + 20
        drawings.append(drawing(width, height, title, *parts, class_="chart c-blue"))
    box = Box(width=width, height=height, right=22, top=30)
    return picture(drawings, box, {}, titles=[f"cosines, {name}" for name in agents])


FIGURES: dict[str, tuple[Sequence[str], Callable[..., str]]] = {
    "choose-curves.svg": (["choose.tar.xz"], choose_curves),
    "first-agent-curve.svg": (
        ["answer-tiago.tar.xz"],
        partial(learned, title="PAL TIAGo · fixed colours · fast"),
    ),
    "a3c-curve.svg": (
        ["a3c-tuned.tar.xz"],
        partial(learned, title="ABB IRB120 · fixed colours · a3c-tuned"),
    ),
    "reach-success.svg": (
        ["answer.tar.xz", "answer-tiago.tar.xz", "paper.tar.xz"],
        reach_success,
    ),
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
    "damaged-graph-confidence.svg": (
        ["damaged-graph-confidence.csv"],
        partial(damaged_graph, column="confidence", lines=CONFIDENCE, kinds=["wrong"]),
    ),
    "vision.svg": (["vision.md"], vision),
    "sim-to-sim.svg": (
        ["sim-to-sim.md"],
        partial(intervals, number=0, name="Success on the images of five renderings"),
    ),
    "deployment.svg": (
        ["deployment.md"],
        partial(intervals, number=1, name="Success over ROS 2 by delay"),
    ),
    "reasoning.svg": (["grounding.md"], reasoning),
    "speed.svg": (["world.json"], speed),
    "cosines.svg": ([], cosines),
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
