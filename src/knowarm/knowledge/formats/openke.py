"""OpenKE folders: text files of names, ids and triples, split into train, valid and test."""

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.formats.tables import text_lines
from knowarm.knowledge.graph.graph import KnowledgeGraph, Names

if TYPE_CHECKING:
    from knowarm.knowledge.kge.train import Split

PARTS = ("train", "valid", "test")
_NUMBER = re.compile("[0-9]{1,9}")


def is_openke(folder: Path) -> bool:
    """Return whether a folder holds OpenKE's files."""
    return all((folder / f"{name}2id.txt").is_file() for name in ("entity", "relation", "train"))


def read_openke_split(folder: Path) -> "Split":
    """Read the triples of a folder as they are split; parts without a file are empty.

    `entity2id.txt` and `relation2id.txt` hold `name<tab>id`, `train2id.txt`, `valid2id.txt` and
    `test2id.txt` hold `head tail relation`. The first line of each is the number of the others.
    """
    if not is_openke(folder):
        raise UserError(
            f"{folder} is no OpenKE folder: it must hold entity2id.txt, relation2id.txt and "
            f"train2id.txt (and may hold valid2id.txt and test2id.txt)."
        )
    names, entity_rank = _read_names(folder / "entity2id.txt")
    relation_names, relation_rank = _read_names(folder / "relation2id.txt")
    parts = {}
    for part in PARTS:
        ids = _read_triples(folder / f"{part}2id.txt", len(entity_rank), len(relation_rank))
        parts[part] = np.stack(
            [entity_rank[ids[:, 0]], relation_rank[ids[:, 2]], entity_rank[ids[:, 1]]], axis=1
        )
    triples, nodes = np.concatenate(list(parts.values())), np.arange(len(names), dtype=np.int32)
    graph = KnowledgeGraph(names, relation_names, triples, nodes=nodes)
    distinct = [np.unique(part, axis=0) for part in parts.values()]
    rows, counts = np.unique(np.concatenate(distinct), axis=0, return_counts=True)
    for head, relation, tail in rows[counts > 1][:1]:
        raise UserError(
            f"{folder}: the triple {names[head]} {relation_names[relation]} {names[tail]} is in "
            f"several of {', '.join(f'{part}2id.txt' for part in PARTS)}. Leave it in one of them."
        )
    from knowarm.knowledge.kge.train import Split  # torch takes a second to import

    return Split(graph=graph, **parts)


def _read_names(path: Path) -> tuple[Names, np.ndarray]:
    """Return the names sorted, and the new id of each id of the file, (n,) int64."""
    by_id: dict[int, str] = {}
    lines = _counted_lines(path)
    for number, line in lines:
        name, _, text = line.rpartition("\t") if "\t" in line else line.rpartition(" ")
        if not name or not _NUMBER.fullmatch(text.strip()):
            raise UserError(
                f"{path}, line {number}: expected `name<tab>id`, got {line!r}. Correct the line."
            )
        by_id[int(text)] = name
    if sorted(by_id) != list(range(len(lines))) or len(set(by_id.values())) < len(lines):
        raise UserError(
            f"{path}: holds {len(lines)} lines, but not as many different names with the ids 0 to "
            f"{len(lines) - 1}. Give every name one id, and every id one name."
        )
    order = sorted(by_id, key=lambda i: by_id[i])
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return Names(by_id[i] for i in order), rank


def _read_triples(path: Path, entities: int, relations: int) -> np.ndarray:
    """Return (n, 3) int64: head, tail, relation, in OpenKE's order."""
    rows: list[tuple[int, ...]] = []
    for number, line in _counted_lines(path) if path.exists() else ():
        cells = line.split()
        if len(cells) != 3 or not all(map(_NUMBER.fullmatch, cells)):
            raise UserError(
                f"{path}, line {number}: expected three ids `head tail relation`, got {line!r}. "
                f"Correct the line."
            )
        rows.append(tuple(map(int, cells)))
        if max(rows[-1][:2]) >= entities or rows[-1][2] >= relations:
            raise UserError(
                f"{path}, line {number}: {line!r} holds an id that is not among the {entities} "
                f"entities and {relations} relations. OpenKE's order is `head tail relation`."
            )
    return np.array(rows, np.int64).reshape(-1, 3)


def _counted_lines(path: Path) -> list[tuple[int, str]]:
    """Return the numbered lines after the first one, which is their count, without blank ones."""
    lines = [(number, line) for number, line in text_lines(path) if line and not line.isspace()]
    first = lines[0][1].strip() if lines else "0"
    if not _NUMBER.fullmatch(first) or int(first) != len(lines[1:]):
        raise UserError(
            f"{path}, line 1: the first line must be the number of lines that follow, "
            f"{len(lines[1:])}, got {first!r}. Correct the count or the lines."
        )
    return lines[1:]
