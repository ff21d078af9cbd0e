"""Draw and store the suites of the benchmark.

python -m scripts.freeze_suites reach-v1

A published suite is never written again: it is drawn again, and its digest compared.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import get_args

from knowarm.arrays import Integers
from knowarm.benchmark.freezing import SEED, freeze, freeze_cell
from knowarm.benchmark.suites import FOLDER, Cell, Split, Suite, read_suite
from knowarm.experiment.evaluation import EvaluationConfig, SplitTest
from knowarm.experiment.names import experiment_config
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.graph.damage import Damage, damaged
from knowarm.world.tasks.skills.sort.sort import Sort

REACH = {"fixed": "bm", "randomized": "bm-dr"}
SPLITS: tuple[Split, ...] = ("S1", "S2", "S3", "S4", "S5")
GROUPS = {"pick": "lift", "place": "sort", "named": "sort"}
"""Skills of tasks among solid objects, by the name of their tables."""
SOLID_SPLITS: dict[str, tuple[Split, ...]] = {
    "pick": ("S1", "S2", "S4", "S5"),
    "place": ("S1", "S2", "S4", "S5"),
    "named": ("S1", "S5"),
}
SOLID_EPISODES = 75
SOLID_CONTROLS = 25
"""Episodes of their cells, and those of controls; contacts cost a third of a second each."""

_report = partial(print, flush=True)


def cell(name: str, experiment: str, how: EvaluationConfig) -> Cell:
    """Draw a cell of the task of an experiment."""
    return freeze_cell(name, experiment_config(experiment).env, how, report=_report)


def reach() -> Suite:
    """The paper's cells: both robots, fixed and randomized colours."""
    how = EvaluationConfig(distance_m=0.05, angle_deg=15.0)
    cells = [
        cell(f"{robot}-{colours}", f"{robot}-{agent}-fast", how)
        for robot in ("irb120", "tiago")
        for colours, agent in REACH.items()
    ]
    about = "Reach the grasp pose of the visible object, within 5 cm and 15 degrees."
    return freeze("reach-v1", about, cells)


def choose() -> Suite:
    """The choose task: both robots, splits S1 to S5."""
    cells = []
    for robot in ("irb120", "tiago"):
        for split in SPLITS:
            how = EvaluationConfig(
                distance_m=0.05, angle_deg=15.0, test=(SplitTest(split=split),)
            )
            cells.append(cell(f"{robot}-{split}", f"{robot}-choose-bm-fast", how))
    about = (
        "Reach the object, of four, that a query describes, within 5 cm and 15 degrees. S1: new "
        "layouts; S2: new pairs of condition and object; S3: new objects; S4: new values; S5: an "
        "edited graph."
    )
    return freeze("choose-v1", about, cells)


def damaged_graph() -> Suite:
    """Split S1 of choose-v1, episode for episode, with graphs of which 30 % are damaged."""
    cells, graph = [], read_graph("objects")
    for robot in ("irb120", "tiago"):
        whole = read_suite("choose-v1").cells[f"{robot}-S1"]
        for kind in get_args(Damage):
            broken = damaged(graph, kind, 0.3, SEED, whole.env.targets)
            cells.append(replace(whole, name=f"{robot}-{kind}", graph=broken))
    about = (
        "The episodes of choose-v1's split S1, with a graph of which 30 % of the triples about the "
        "objects are damaged: missing; wrong (another tail of the relation); adversarial (values "
        "swapped in pairs). The undamaged graph judges."
    )
    return freeze("damaged-graph-v1", about, cells)


def solid_cells(robot: str) -> list[Cell]:
    """Tasks among solid objects on a robot."""
    cells = []
    listed: dict[str, Integers] = {}  # asked or not, the same objects stand there
    for group, skill in GROUPS.items():
        env = experiment_config(f"{robot}-choose-{skill}-answers-seen").env
        if group == "named":
            task = replace(env.task, skill=Sort(destination="place"))
            env = replace(env, task=task)
        for split in SOLID_SPLITS[group]:
            how = EvaluationConfig(
                distance_m=0.05, angle_deg=15.0, test=(SplitTest(split=split),)
            )
            name = f"{robot}-{group}-{split}"
            known = listed.get(skill)
            drawn = freeze_cell(name, env, how, SOLID_EPISODES, _report, known)
            listed[skill] = drawn.open_loop
            cells.append(replace(drawn, group=group))
    return cells


def pick_and_place() -> Suite:
    """Lift, or put where it belongs or where it is said, one of four solid objects."""
    with ProcessPoolExecutor() as pool:
        cells = list(chain.from_iterable(pool.map(solid_cells, ("irb120", "tiago"))))
    about = (
        "Lift the solid object, of four, that a query describes (pick), put it on the tray of the "
        "place where the graph says that it belongs (place), or of the place that the question "
        "names (named). S1: new layouts; S2: new pairs of condition and object; S4: new values; "
        "S5: an edited graph."
    )
    return freeze("pick-and-place-v1", about, cells, control_episodes=SOLID_CONTROLS)


SUITES = {
    "reach-v1": reach,
    "choose-v1": choose,
    "damaged-graph-v1": damaged_graph,
    "pick-and-place-v1": pick_and_place,
}


def store(name: str) -> str:
    """Draw a suite; store it, or compare it with the published one. Return a line about it.

    Raises:
        SystemExit: it differs from the published one.
    """
    suite = SUITES[name]()
    if (FOLDER / f"{name}.json").exists():
        published = read_suite(name).digest
        if suite.digest != published:
            raise SystemExit(
                f"{name} is published with digest {published[:16]}, and drawn again it has "
                f"{suite.digest[:16]}: nothing is written. Make a new version."
            )
        return f"{name} {suite.digest}, as it is published"
    for suffix, data in zip((".json", ".safetensors"), suite.data, strict=True):
        (FOLDER / f"{name}{suffix}").write_bytes(data)
    return f"{name} {suite.digest}, new"


if __name__ == "__main__":
    for name in sys.argv[1:]:
        print(store(name))
