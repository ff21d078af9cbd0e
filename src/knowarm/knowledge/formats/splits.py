"""Folders of triples split into train, valid and test: OpenKE's files of ids, or text files."""

import os
import re
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.formats.files import text_lines
from knowarm.knowledge.formats.tables import read_table
from knowarm.knowledge.graph.builder import graph_of
from knowarm.knowledge.graph.graph import Ids, KnowledgeGraph, Names, Triple

PARTS = ("train", "valid", "test")
_NAME = re.compile(r"(.+)[\t ]\s*([0-9]{1,9})\s*")
_TRIPLE = re.compile(r"[\s,]*([0-9]{1,9})[\s,]+([0-9]{1,9})[\s,]+([0-9]{1,9})[\s,]*")
Parts = dict[str, Ids]
"""Ids of head, relation and tail of the triples of each part, (n, 3) int64."""


def read_parts(folder: Path) -> tuple[KnowledgeGraph, Parts]:
    """Read the triples of a folder as they are split; parts without a file are empty.

    OpenKE: `entity2id.txt` and `relation2id.txt` hold `name<tab>id`, `train2id.txt`,
    `valid2id.txt` and `test2id.txt` hold `head tail relation`; the first line of each is the number
    of the others. Text: `train.txt`, `valid.txt` and `test.txt` are tables of names.
    """
    openke = ("entity2id.txt", "relation2id.txt", "train2id.txt")
    if all(map(Path.is_file, map(folder.joinpath, openke))):
        return _read_openke(folder)
    if not (folder / "train.txt").is_file():
        raise UserError(
            f"{folder} is no folder of triples: it must hold train.txt (and may hold valid.txt and "
            "test.txt), or OpenKE's entity2id.txt, relation2id.txt and train2id.txt."
        )
    labels: dict[str, str] = {}
    confidence: dict[Triple, float] = {}
    graphs = {}
    for part in PARTS:
        file = folder / f"{part}.txt"
        if os.path.lexists(file):  # what is no file is refused
            graphs[part] = read_table(file, "\t")
            labels.update(graphs[part].labels)
            confidence.update(graphs[part].confidence)
    triples = chain.from_iterable(graphs.values())
    whole = graph_of(triples, labels=labels, confidence=confidence)
    parts = dict.fromkeys(PARTS, np.empty((0, 3), np.int64))
    for part, graph in graphs.items():
        entities = np.array(list(map(whole.names.find, graph.names)))
        relations = np.array(list(map(whole.relation_names.find, graph.relation_names)))
        heads = entities[graph.heads]
        middle = relations[graph.relations]
        tails = entities[graph.tails]
        parts[part] = np.stack([heads, middle, tails], axis=1)
    return whole, parts


def _read_openke(folder: Path) -> tuple[KnowledgeGraph, Parts]:
    names, entities = _read_names(folder / "entity2id.txt")
    relation_names, relations = _read_names(folder / "relation2id.txt")
    parts = Parts()
    for part in PARTS:
        path = folder / f"{part}2id.txt"
        triples = []
        for where, cells in _rows(path, _TRIPLE, "three ids `head tail relation`"):
            head, tail, relation = map(int, cells)
            if max(head, tail) >= len(entities) or relation >= len(relations):
                raise UserError(
                    f"{where}: '{head} {tail} {relation}' holds an id that is not among the "
                    f"{len(entities)} entities and {len(relations)} relations. OpenKE's order is "
                    "`head tail relation`."
                )
            triples.append([entities[head], relations[relation], entities[tail]])
        parts[part] = np.array(triples, np.int64).reshape(-1, 3)
    nodes = np.arange(len(names), dtype=np.int32)
    whole = np.concatenate(list(parts.values()))
    return KnowledgeGraph(names, relation_names, whole, nodes=nodes), parts


def _read_names(path: Path) -> tuple[Names, list[int]]:
    """Return the names sorted, and the new id of each id of the file."""
    by_id = {}
    count = 0
    for _, (name, number) in _rows(path, _NAME, "`name<tab>id`"):
        by_id[int(number)] = name
        count += 1
    if sorted(by_id) != list(range(count)) or len(set(by_id.values())) < count:
        raise UserError(
            f"{path}: holds {count} lines, but not as many different names with the ids 0 to "
            f"{count - 1}. Give every name one id, and every id one name."
        )
    order = sorted(by_id, key=by_id.__getitem__)
    return Names(sorted(by_id.values())), np.argsort(order).tolist()


def _rows(
    path: Path, pattern: re.Pattern[str], expected: str
) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield where each line after the first is, and its cells; the first is the number of lines.

    There are none if there is no file.
    """
    lines = []
    if path.exists():
        lines = [(number, line) for number, line in text_lines(path) if line.strip()]
    first = lines[0][1].strip() if lines else "0"
    rest = lines[1:]
    if not first.isdecimal() or int(first) != len(rest):
        raise UserError(
            f"{path}, line 1: the first line must be the number of lines that follow, "
            f"{len(rest)}, got {first!r}. Correct the count or the lines."
        )
    for number, line in rest:
        where = f"{path}, line {number}"
        match = pattern.fullmatch(line)
        if match is None:
            raise UserError(
                f"{where}: expected {expected}, got {line!r}. Correct the line."
            )
        yield where, match.groups()
