"""Folders of triples split into train, valid and test: OpenKE's files of ids, or text files."""

import re
from itertools import chain
from pathlib import Path

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.formats.files import text_lines
from knowarm.knowledge.formats.tables import read_table
from knowarm.knowledge.graph.builder import graph_of
from knowarm.knowledge.graph.graph import Ids, KnowledgeGraph, Names, Triple

PARTS = ("train", "valid", "test")
_NUMBER = re.compile("[0-9]{1,9}")
Parts = dict[str, Ids]
"""Ids of head, relation and tail of the triples of each part, (n, 3) int64."""


def is_split(folder: Path) -> bool:
    """Return whether a folder holds a split."""
    return _is_openke(folder) or (folder / "train.txt").is_file()


def read_parts(folder: Path) -> tuple[KnowledgeGraph, Parts]:
    """Read the triples of a folder as they are split; parts without a file are empty.

    OpenKE: `entity2id.txt` and `relation2id.txt` hold `name<tab>id`, `train2id.txt`,
    `valid2id.txt` and `test2id.txt` hold `head tail relation`; the first line of each is the number
    of the others. Text: `train.txt`, `valid.txt` and `test.txt` are tables of names.
    """
    if _is_openke(folder):
        return _read_openke(folder)
    if not is_split(folder):
        raise UserError(
            f"{folder} is no folder of triples: it must hold train.txt (and may hold valid.txt and "
            "test.txt), or OpenKE's entity2id.txt, relation2id.txt and train2id.txt."
        )
    labels = dict[str, str]()
    confidence = dict[Triple, float]()
    graphs = dict[str, KnowledgeGraph]()
    for part in PARTS:
        file = folder / f"{part}.txt"
        if file.is_file():
            graphs[part] = read_table(file, "\t")
            labels.update(graphs[part].labels)
            confidence.update(graphs[part].confidence)
    triples = chain.from_iterable(graphs.values())
    whole = graph_of(triples, labels=labels, confidence=confidence)
    parts = dict.fromkeys(PARTS, np.empty((0, 3), np.int64))
    for part, graph in graphs.items():
        entities = np.array(list(map(whole.names.find, graph.names)))
        relations = np.array(list(map(whole.relation_names.find, graph.relation_names)))
        ids = [entities[graph.heads], relations[graph.relations], entities[graph.tails]]
        parts[part] = np.stack(ids, axis=1)
    return whole, parts


def _is_openke(folder: Path) -> bool:
    names = ("entity2id.txt", "relation2id.txt", "train2id.txt")
    return all((folder / name).is_file() for name in names)


def _read_openke(folder: Path) -> tuple[KnowledgeGraph, Parts]:
    names, entities = _read_names(folder / "entity2id.txt")
    relation_names, relations = _read_names(folder / "relation2id.txt")
    parts = Parts()
    for part in PARTS:
        path = folder / f"{part}2id.txt"
        head, tail, relation = _read_triples(path, len(entities), len(relations)).T
        ids = [entities[head], relations[relation], entities[tail]]
        parts[part] = np.stack(ids, axis=1)
    triples = np.concatenate(list(parts.values()))
    nodes = np.arange(len(names), dtype=np.int32)
    return KnowledgeGraph(names, relation_names, triples, nodes=nodes), parts


def _read_names(path: Path) -> tuple[Names, Ids]:
    """Return the names sorted, and the new id of each id of the file, (n,) int64."""
    by_id: dict[int, str] = {}
    lines = _counted_lines(path)
    for number, line in lines:
        name, _, text = line.rpartition("\t" if "\t" in line else " ")
        if not name or not _NUMBER.fullmatch(text.strip()):
            raise UserError(
                f"{path}, line {number}: expected `name<tab>id`, got {line!r}. Correct the line."
            )
        by_id[int(text)] = name
    count = len(lines)
    if sorted(by_id) != list(range(count)) or len(set(by_id.values())) < count:
        raise UserError(
            f"{path}: holds {count} lines, but not as many different names with the ids 0 to "
            f"{count - 1}. Give every name one id, and every id one name."
        )
    order = sorted(by_id, key=by_id.__getitem__)
    return Names(sorted(by_id.values())), np.argsort(order)


def _read_triples(path: Path, entities: int, relations: int) -> Ids:
    """Return (n, 3) int64: head, tail, relation, in OpenKE's order."""
    rows: list[list[int]] = []
    for number, line in _counted_lines(path) if path.exists() else ():
        cells = line.replace(",", " ").split()
        if len(cells) != 3 or not all(map(_NUMBER.fullmatch, cells)):
            raise UserError(
                f"{path}, line {number}: expected three ids `head tail relation`, got {line!r}. "
                f"Correct the line."
            )
        head, tail, relation = map(int, cells)
        rows.append([head, tail, relation])
        if max(head, tail) >= entities or relation >= relations:
            raise UserError(
                f"{path}, line {number}: {line!r} holds an id that is not among the {entities} "
                f"entities and {relations} relations. OpenKE's order is `head tail relation`."
            )
    return np.array(rows, np.int64).reshape(-1, 3)


def _counted_lines(path: Path) -> list[tuple[int, str]]:
    """Return the numbered lines after the first one, which is their count, without blank ones."""
    lines = [(number, line) for number, line in text_lines(path) if line.strip()]
    first = lines[0][1].strip() if lines else "0"
    rest = lines[1:]
    if not _NUMBER.fullmatch(first) or int(first) != len(rest):
        raise UserError(
            f"{path}, line 1: the first line must be the number of lines that follow, "
            f"{len(rest)}, got {first!r}. Correct the count or the lines."
        )
    return rest
