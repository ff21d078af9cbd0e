"""OpenKE folders: text files of names, ids and triples, split into train, valid and test."""

from pathlib import Path

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.formats.lines import text_lines
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.kge.split import Split
from knowarm.knowledge.names import Names

PARTS = ("train", "valid", "test")


def is_number(text: str) -> bool:
    """Return whether a text is a number of at most 9 ASCII digits; `isdigit` accepts others."""
    return text.isascii() and text.isdigit() and len(text) <= 9


def is_openke(folder: Path) -> bool:
    """Return whether a folder holds OpenKE's files."""
    return all((folder / f"{name}2id.txt").is_file() for name in ("entity", "relation", "train"))


def read_openke(folder: Path) -> KnowledgeGraph:
    """Read all triples of a folder: training, validation and test."""
    return read_openke_split(folder).graph


def read_openke_split(folder: Path) -> Split:
    """Read the triples of a folder as they are split; parts without a file are empty.

    `entity2id.txt` and `relation2id.txt` hold `name<tab>id`, `train2id.txt`, `valid2id.txt` and
    `test2id.txt` hold `head tail relation`. The first line of each is the number of the others.

    Raises:
        UserError: a file is missing or malformed; the line is named.
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
    graph = KnowledgeGraph(
        names,
        relation_names,
        np.concatenate(list(parts.values())),
        nodes=np.arange(len(names), dtype=np.int32),
    )
    return Split(graph=graph, **parts)


def write_openke(split: Split, folder: Path) -> None:
    """Write the folder that `read_openke_split` reads. Names must not contain tabs."""
    folder.mkdir(parents=True, exist_ok=True)
    for kind, names in (("entity", split.graph.names), ("relation", split.graph.relation_names)):
        _write(folder / f"{kind}2id.txt", [f"{name}\t{i}" for i, name in enumerate(names)])
    for part in PARTS:
        lines = [f"{h} {t} {r}" for h, r, t in getattr(split, part).tolist()]
        _write(folder / f"{part}2id.txt", lines)


def _write(path: Path, lines: list[str]) -> None:
    path.write_text("\n".join([str(len(lines)), *lines]) + "\n", encoding="utf-8")


def _read_names(path: Path) -> tuple[Names, np.ndarray]:
    """Return the names sorted, and the new id of each id of the file, (n,) int64."""
    by_id: dict[int, str] = {}
    line_of: dict[str, int] = {}
    count, lines = _counted_lines(path)
    for number, line in lines:
        name, _, text = line.rpartition("\t") if "\t" in line else line.rpartition(" ")
        if not name or not is_number(text.strip()):
            raise UserError(
                f"{path}, line {number}: expected `name<tab>id`, got {line!r}. Correct the line."
            )
        if name in line_of:
            raise UserError(
                f"{path}, line {number}: the name {name!r} is already in line {line_of[name]}. "
                f"Give every id a name of its own."
            )
        line_of[name] = number
        by_id[int(text)] = name
    if sorted(by_id) != list(range(count)):
        raise UserError(
            f"{path}, line 1: announces {count} names with the ids 0 to {count - 1}, but "
            f"{len(by_id)} different ids follow. Correct the count or the ids."
        )
    order = sorted(by_id, key=lambda i: by_id[i])
    rank = np.empty(count, np.int64)
    rank[order] = np.arange(count)
    return Names.from_sorted(by_id[i] for i in order), rank


def _read_triples(path: Path, entities: int, relations: int) -> np.ndarray:
    """Return (n, 3) int64: head, tail, relation, in OpenKE's order."""
    if not path.exists():
        return np.empty((0, 3), np.int64)
    rows: list[tuple[int, int, int]] = []
    limits = (entities, entities, relations)
    count, lines = _counted_lines(path)
    for number, line in lines:
        cells = line.split()
        if len(cells) != 3 or not all(map(is_number, cells)):
            raise UserError(
                f"{path}, line {number}: expected three ids `head tail relation`, got {line!r}. "
                f"Correct the line."
            )
        row = (int(cells[0]), int(cells[1]), int(cells[2]))
        for kind, value, limit in zip(("head", "tail", "relation"), row, limits, strict=True):
            if value >= limit:
                raise UserError(
                    f"{path}, line {number}: {kind} id {value} is not among the {limit} named "
                    f"ones. OpenKE's order is `head tail relation`."
                )
        rows.append(row)
    if len(rows) != count:
        raise UserError(
            f"{path}, line 1: announces {count} triples, but {len(rows)} follow. "
            f"Correct the count or add the missing lines."
        )
    return np.array(rows, np.int64).reshape(-1, 3)


def _counted_lines(path: Path) -> tuple[int, list[tuple[int, str]]]:
    """Return the count of the first line, and the numbered lines after it that are not blank."""
    lines = [(number, line) for number, line in text_lines(path) if line and not line.isspace()]
    if not lines:
        return 0, []
    (number, first), *rest = lines
    if not is_number(first.strip()):
        raise UserError(
            f"{path}, line {number}: the first line must be the number of lines that follow, "
            f"got {first!r}."
        )
    return int(first), rest
