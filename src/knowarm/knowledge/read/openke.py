"""A folder of OpenKE id files goes in; a graph, with its own split, comes out."""

from pathlib import Path

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.kge.split import Split
from knowarm.knowledge.names import Names
from knowarm.knowledge.read.lines import numbered_lines

PARTS = ("train", "valid", "test")


def is_openke(folder: Path) -> bool:
    """Whether a folder holds OpenKE's files."""
    return all((folder / f"{name}2id.txt").is_file() for name in ("entity", "relation", "train"))


def read_openke(folder: Path) -> KnowledgeGraph:
    """Read all triples of the folder: training, validation and test."""
    return read_openke_split(folder).graph


def read_openke_split(folder: Path) -> Split:
    """Read the folder's triples in the parts that it brings; missing parts are empty.

    `entity2id.txt` and `relation2id.txt` hold `name<tab>id`, the `...2id.txt` of triples hold
    `head tail relation`; the first line of each is the number of the others.

    Raises:
        UserError: a file is missing or malformed, with its line.
    """
    if not is_openke(folder):
        raise UserError(
            f"{folder} is no OpenKE folder: it must hold entity2id.txt, relation2id.txt and "
            f"train2id.txt (and may hold valid2id.txt and test2id.txt)."
        )
    names, entity_rank = _sorted_names(folder / "entity2id.txt")
    relation_names, relation_rank = _sorted_names(folder / "relation2id.txt")
    parts = {}
    for part in PARTS:
        ids = _read_triples(folder / f"{part}2id.txt", len(entity_rank), len(relation_rank))
        parts[part] = np.stack(
            [entity_rank[ids[:, 0]], relation_rank[ids[:, 2]], entity_rank[ids[:, 1]]], axis=1
        )
    graph = KnowledgeGraph(
        names,
        relation_names,
        np.concatenate(list(parts.values())),
        nodes=np.arange(len(names), dtype=np.int32),
    )
    return Split(graph=graph, **parts)


def _sorted_names(path: Path) -> tuple[Names, np.ndarray]:
    """Return the names sorted, and the new id of each id of the file, (n,) int64."""
    by_id: dict[int, str] = {}
    line_of: dict[str, int] = {}
    count = -1
    for number, line in numbered_lines(path):
        if count < 0:
            count = _count(path, number, line)
            continue
        name, _, text = line.rpartition("\t") if "\t" in line else line.rpartition(" ")
        if not name or not text.strip().isdigit():
            raise UserError(
                f"{path}, line {number}: expected `name<tab>id`, got {line!r}. Mend that line."
            )
        if name in line_of:
            raise UserError(
                f"{path}, line {number}: the name {name!r} stands in line {line_of[name]} already. "
                f"Give every id its own name."
            )
        line_of[name] = number
        by_id[int(text)] = name
    if sorted(by_id) != list(range(count)):
        raise UserError(
            f"{path}, line 1: promises {count} names with the ids 0 to {count - 1}, but "
            f"{len(by_id)} different ids follow. Correct the count or the ids."
        )
    order = sorted(by_id, key=lambda i: by_id[i])
    rank = np.empty(count, np.int64)
    rank[order] = np.arange(count)
    return Names.from_sorted(by_id[i] for i in order), rank


def _read_triples(path: Path, entities: int, relations: int) -> np.ndarray:
    """Return (n, 3) int64: head, tail, relation, as OpenKE orders them."""
    rows: list[tuple[int, int, int]] = []
    if not path.exists():
        return np.empty((0, 3), np.int64)
    count = -1
    limits = (entities, entities, relations)
    for number, line in numbered_lines(path):
        if count < 0:
            count = _count(path, number, line)
            continue
        cells = line.split()
        if len(cells) != 3 or not all(cell.isdigit() for cell in cells):
            raise UserError(
                f"{path}, line {number}: expected three ids `head tail relation`, got {line!r}. "
                f"Mend that line."
            )
        row = (int(cells[0]), int(cells[1]), int(cells[2]))
        for kind, value, limit in zip(("head", "tail", "relation"), row, limits, strict=True):
            if value >= limit:
                raise UserError(
                    f"{path}, line {number}: {kind} id {value} is not among the {limit} that are "
                    f"named. OpenKE's order is `head tail relation`."
                )
        rows.append(row)
    if len(rows) != max(count, 0):
        raise UserError(f"{path}, line 1: promises {count} triples, but {len(rows)} follow.")
    return np.array(rows, np.int64).reshape(-1, 3)


def _count(path: Path, number: int, line: str) -> int:
    if not line.strip().isdigit():
        raise UserError(
            f"{path}, line {number}: the first line must be the number of lines that follow, "
            f"got {line!r}."
        )
    return int(line)
