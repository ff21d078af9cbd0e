"""Columns of tables and keys of records: which hold head, relation and tail of a triple."""

import re
import unicodedata
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

from knowarm.errors import UserError
from knowarm.knowledge.graph.terms import NAMESPACE, is_iri, name_of_iri, parse_literal

ROLES = {
    "head": ("head", "subject", "subj", "h", "s", "node1", "entity1", "e1", "start_id", "start",
             "source", "src", "from"),
    "relation": ("relation", "predicate", "relationship", "property", "rel", "pred", "r", "p",
                 "edge", "edge_type", "label", "labels", "type", "name"),
    "tail": ("tail", "object", "obj", "t", "o", "node2", "entity2", "e2", "end_id", "end",
             "target", "dst", "to", "value"),
}  # fmt: skip
"""Names of the three columns, the surest first: a source beside a subject is a reference."""


CONFIDENCE = "confidence"
"""Name of the column with the probability that a triple holds."""


class Columns(NamedTuple):
    """Numbers of the columns of a triple."""

    head: int
    relation: int
    tail: int


def columns_of(names: Sequence[str], where: Path) -> Columns | None:
    """Return the columns that names tell; None if they name neither head nor tail.

    Raises:
        UserError: they name head and tail, and no relation.
    """
    keys = list(map(_key, names))
    head, relation, tail = (_column(keys, role) for role in ROLES)
    if head is None or tail is None:
        return None
    if relation is None:
        raise UserError(
            f"{where}: none of {listed(names)} names the relation. Name the "
            f"relation one of {', '.join(ROLES['relation'])}."
        )
    return Columns(head, relation, tail)


def _column(keys: list[str], role: str) -> int | None:
    """Return the first of the columns that have the surest of the names for a role."""
    for name in ROLES[role]:
        if name in keys:
            return keys.index(name)
    return None


def _key(name: str) -> str:
    """Return the name of a column in lower case: "start_id" of ":START_ID(Person)"."""
    return (
        re.sub(r"\(.*\)$", "", name.strip().lower())
        .lstrip("#")
        .rpartition(":")[2]
        .strip()
    )


def name_of_cell(cell: str) -> str:
    """Return the name that a cell holds: one blank between words, letters in the form NFC."""
    if cell.isascii() and cell.isidentifier():  # most: fast
        return cell
    cell = cell.strip()
    if cell.startswith(NAMESPACE):
        return name_of_iri(cell)
    if is_iri(cell) or cell.startswith("_:") or parse_literal(cell) is not None:
        return cell
    return unicodedata.normalize("NFC", " ".join(cell.split()))


def confidence_of(value: object, where: str) -> float:
    """Return the probability that a cell states; an empty one states that the triple is certain."""
    with suppress(ValueError):
        confidence = float(str(value) or 1)
        if 0 <= confidence <= 1:
            return confidence
    raise UserError(
        f"{where}: the confidence is {value!r}; it must be a number from 0 to 1, such as 0.9."
    )


def listed(names: Iterable[str]) -> str:
    """Return names of a file for a message of one line."""
    return ", ".join(map(name_of_cell, names))


def cell_of_name(name: str) -> str:
    """Return the cell of which `name_of_cell` makes the name: its IRI where it must be exact."""
    if name_of_cell(name) == name:
        return name
    return NAMESPACE + quote(name, safe="")
