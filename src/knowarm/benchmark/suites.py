"""Suites: tasks, episodes, thresholds and controls, stored as data that no later change touches.

A suite is a JSON file and a safetensors file of the same name. Their digest names the suite; what
changes a score makes a new version, ``choose-v2``, beside the old one. A suite of one's own is a
folder of `knowarm benchmark freeze`, in which these files, ``suite``, name copies of its inputs.
"""

import json
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load

from knowarm.arrays import Integers
from knowarm.config import from_dict
from knowarm.errors import UserError, unknown_name
from knowarm.experiment.run_inputs import input_content, with_inputs
from knowarm.knowledge import KnowledgeGraph
from knowarm.knowledge.graph.builder import graph_of
from knowarm.knowledge.queries.splits import Split
from knowarm.reading import digest, read_bytes, reading
from knowarm.world.config import EnvConfig
from knowarm.world.description import check_trusted
from knowarm.world.tasks.sampling import Episodes

FOLDER = Path(__file__).parent / "suites"

FILE = "suite"
"""Name of the files of a suite of one's own, without suffix."""

CONTROLS = {
    "open-loop": "the best fixed list of actions that a search found",
    "black": "the policy on black images",
    "frozen": "the policy, which sees only the first image of an episode",
    "shuffled query": "the policy with the queries of other episodes",
    "shuffled facts": "the policy given what holds in other episodes, as which tray is which place",
    "shuffled graph": "the policy with a graph whose tails are permuted within each relation",
    "shuffled places": "the policy where such a graph says where objects belong",
    "shuffled both": "the policy where such a graph says both",
    "unknown places": "the policy where nothing says where objects belong or have to be put",
    "intact graph": "the policy with the graph before its damage",
}
"""Controls that can stand beside a score, in the order of tables, and what they are."""


@dataclass(frozen=True)
class Cell:
    """One task of a suite with its episodes.

    Attributes:
        env: the task, every field of it; thresholds included.
        split: of the choose task, else None.
        episodes: what every policy plays.
        open_loop: the best fixed list of actions, (T, J).
        reference: success of the oracle and of the fixed list, and chance, when it was frozen.
        graph: what a policy may use in place of its own graph; None leaves it its own.
        group: words before the name of its table, where a suite has several tasks.
    """

    name: str
    env: EnvConfig
    split: Split | None
    episodes: Episodes
    open_loop: Integers
    reference: dict[str, float | None]
    graph: KnowledgeGraph | None = None
    group: str = ""

    @property
    def table(self) -> str:
        """Table that the cell belongs to: one per group, robot and choice of colours."""
        words = (self.group, Path(self.env.robot).stem, f"{self.env.colours} colours")
        return ", ".join(filter(None, words))


@dataclass(frozen=True)
class Suite:
    """A frozen list of cells.

    Attributes:
        training_seeds: number of training seeds that a complete row has.
        control_episodes: number of episodes, from the first, that the controls play.
    """

    name: str
    about: str
    training_seeds: int
    control_episodes: int
    cells: dict[str, Cell]
    data: tuple[bytes, bytes]

    @cached_property
    def digest(self) -> str:
        """SHA-256 of both files."""
        return digest(b"".join(self.data))

    def episodes_played(self, cell: str, who: str) -> int:
        """Return how many episodes of a cell the "policy" or a control plays."""
        count = len(self.cells[cell].episodes)
        if who == "policy":
            return count
        return min(self.control_episodes, count)


def by_table(cells: Iterable[Cell]) -> dict[str, list[str]]:
    """Return the names of the cells of each table."""
    names: dict[str, list[str]] = {}
    for cell in cells:
        names.setdefault(cell.table, []).append(cell.name)
    return names


def suite_names() -> list[str]:
    """Names of the shipped suites."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


def read_suite(name: str) -> Suite:
    """Read a shipped suite, or one's own by its folder.

    Raises:
        UserError: there is no suite of this name, its files are damaged, or a file that it names
            was changed since.
    """
    if name in suite_names():
        text = read_bytes(FOLDER / f"{name}.json")
        return parse_suite(text, read_bytes(FOLDER / f"{name}.safetensors"))
    folder = Path(name)
    if not (folder / f"{FILE}.json").is_file():
        raise UserError(
            f"{unknown_name('suite', name, suite_names())} Your own suite is given by its folder, "
            "which `knowarm benchmark freeze` makes."
        )
    remedy = "Restore the folder, or freeze the suite again."
    text = read_bytes(folder / f"{FILE}.json")
    arrays = read_bytes(folder / f"{FILE}.safetensors", remedy=remedy)
    with reading(folder, remedy):
        suite = parse_suite(text, arrays, folder)
    return replace(suite, name=folder.as_posix())


def input_digest(name: str) -> str:
    """Return what a file of the user and all that it needs contain, as 16 letters."""
    return digest(input_content(name).encode())[:16]


def find_cells(name: str) -> tuple[Suite, list[Cell]]:
    """Return a suite and some of its cells by SUITE, or SUITE/CELL with the beginning of names.

    Raises:
        UserError: there is no such suite or cell.
    """
    suite_name, _, beginning = name.rpartition("/")
    if not suite_name or (Path(name) / f"{FILE}.json").is_file():
        suite_name = name
        beginning = ""
    suite = read_suite(suite_name)
    cells = [cell for key, cell in suite.cells.items() if key.startswith(beginning)]
    if not cells:
        raise UserError(
            f"{suite_name} has no cell {beginning!r}; it has {', '.join(suite.cells)}."
        )
    return suite, cells


def parse_suite(text: bytes, arrays: bytes, folder: Path | None = None) -> Suite:
    """Make a suite of the content of its files; the folder holds copies of what it names.

    Raises:
        UserError: a copy was changed.
    """
    values = json.loads(text)
    del values["format"]
    if folder is not None:
        values = with_inputs(values, partial(_frozen_input, folder))
    columns = load(arrays)
    queries = np.array(values.pop("queries"))
    cells = {}
    for name, cell in values.pop("cells").items():
        env = from_dict(EnvConfig, cell.pop("env"), where=f"{values['name']}.{name}")
        count = len(columns[f"{name}/objects"])
        # Suites whose skills draw nothing do not store it.
        episodes: dict[str, Any] = {"surroundings": np.zeros((count, 0))}
        for field in fields(Episodes):
            stored = f"{name}/{field.name}"
            if stored in columns:
                episodes[field.name] = columns[stored]
        episodes["question"] = queries[episodes["question"]]
        episodes["names"] = np.array(env.targets)[episodes["objects"]]
        graph = cell.pop("graph", None)
        if graph is not None:
            triples = [tuple(line.split("\t")) for line in graph["triples"]]
            graph = graph_of(triples, nodes=graph["entities"])
        cells[name] = Cell(
            name=name,
            env=env,
            episodes=Episodes(**episodes),
            open_loop=columns[f"{name}/open_loop"].astype(np.int64),
            graph=graph,
            **cell,
        )
    return Suite(**values, cells=cells, data=(text, arrays))


def _frozen_input(folder: Path, name: str) -> str:
    """Return the path of the copy of an input, whose folder is named by its content."""
    path = folder / name
    check_trusted(str(path), folder)  # before any of its files is parsed
    if not path.exists() or input_digest(str(path)) != path.parent.name:
        raise UserError(
            f"{path} is missing or was changed since the suite was frozen: restore it."
        )
    return str(path)
