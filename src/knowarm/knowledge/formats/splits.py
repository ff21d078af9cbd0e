"""Folders of triples split into train, valid and test: OpenKE's files of ids, or text files."""

import os
import re
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from knowarm.errors import UserError
from knowarm.knowledge.formats.files import text_lines
from knowarm.knowledge.formats.tables import read_table
from knowarm.knowledge.graph.builder import graph_of
from knowarm.knowledge.graph.graph import KnowledgeGraph, Triple

PARTS = ("train", "valid", "test")
_NAME = re.compile(r"(.+)[\t ]\s*([0-9]{1,9})\s*")
_TRIPLE = re.compile(r"[\s,]*([0-9]{1,9})[\s,]+([0-9]{1,9})[\s,]+([0-9]{1,9})[\s,]*")
Parts = dict[str, list[Triple]]
"""The triples of each part, in the order of its file."""


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
    parts = Parts()
    for part in PARTS:
        parts[part] = []
        file = folder / f"{part}.txt"
        if os.path.lexists(file):  # what is no file is refused
            graph = read_table(file, "\t")
            parts[part] += graph
            labels.update(graph.labels)
            confidence.update(graph.confidence)
    triples = chain.from_iterable(parts.values())
    return graph_of(triples, labels=labels, confidence=confidence), parts


def _read_openke(folder: Path) -> tuple[KnowledgeGraph, Parts]:
    entities = _read_names(folder / "entity2id.txt")
    relations = _read_names(folder / "relation2id.txt")
    parts = Parts()
    for part in PARTS:
        path = folder / f"{part}2id.txt"
        parts[part] = []
        for where, cells in _rows(path, _TRIPLE, "three ids `head tail relation`"):
            head, tail, relation = map(int, cells)
            if max(head, tail) >= len(entities) or relation >= len(relations):
                raise UserError(
                    f"{where}: '{head} {tail} {relation}' holds an id that is not among the "
                    f"{len(entities)} entities and {len(relations)} relations. OpenKE's order is "
                    "`head tail relation`."
                )
            triple = (entities[head], relations[relation], entities[tail])
            parts[part].append(triple)
    return graph_of(chain.from_iterable(parts.values()), nodes=entities), parts


def _read_names(path: Path) -> list[str]:
    """Return the names in the order of their ids."""
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
    return list(map(by_id.__getitem__, range(count)))


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
