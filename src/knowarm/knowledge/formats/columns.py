"""Columns of tables and keys of records: which hold head, relation and tail of a triple."""

import re
import unicodedata
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import chain, product
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

from knowarm.errors import UserError
from knowarm.knowledge.graph.terms import NAMESPACE, is_iri, name_of_iri, parse_literal
from knowarm.reading import read_toml

NAMES = read_toml(Path(__file__).with_name("columns.toml"))
"""Names of columns, of which the file tells."""
PAIRS: tuple[tuple[str, str], ...] = tuple(map(tuple, NAMES["pairs"]))
"""Names of head and tail that stand beside each other, the surest first."""
ROLES = {
    "head": tuple(dict.fromkeys(map(itemgetter(0), PAIRS))),
    "relation": tuple(NAMES["relation"]),
    "tail": (*dict.fromkeys(map(itemgetter(1), PAIRS)), "value"),
}
"""Names of the three columns, the surest first."""
_SURE = (NAMES["sure_heads"], NAMES["sure_tails"])
"""Names of heads and tails that may be mixed."""
_BESIDE = {*PAIRS, *product(*_SURE)}

_ADDITION = re.compile(r"_(entity|name|type|node|concept|term|word|id)$")
"""What may follow a name of a column."""
CONFIDENCE = "confidence"
"""Name of the column with the probability that a triple holds."""


class Columns(NamedTuple):
    """Numbers of columns."""

    triple: tuple[int, int, int]
    """Those of head, relation and tail."""
    confidence: int | None = None
    others: tuple[str, ...] = ()
    """Names of columns that are not read."""


@lru_cache
def columns_of(names: tuple[str, ...], where: str) -> Columns | None:
    """Return the columns that names tell; None if they name neither head nor tail.

    Raises:
        UserError: they name head and tail, and no relation.
    """
    keys = _keys(names)
    heads = list(filter(keys.__contains__, ROLES["head"]))
    tails = list(filter(keys.__contains__, ROLES["tail"]))
    if not heads or not tails:
        return None
    pairs = list(filter(_BESIDE.__contains__, product(heads, tails)))
    if not pairs:
        raise UserError(
            f"{where}: of {listed(names)}, {heads[0]} names a head and {tails[0]} a tail, but not "
            f"of each other. Name them {', '.join(ROLES)}."
        )
    relation = _column(keys, ROLES["relation"])
    if relation is None:
        raise UserError(
            f"{where}: none of {listed(names)} names the relation. Name the "
            f"relation one of {', '.join(ROLES['relation'])}; if there is none and all state the "
            "same, add it."
        )
    truth = sorted(filter(keys.__contains__, NAMES["truth"]))
    if truth:
        raise UserError(
            f"{where}: {truth[0]} says which triples hold. Leave it out, and write those that do "
            "not hold with a relation such as notUsedFor."
        )
    head, tail = map(keys.index, pairs[0])
    confidence = _column(keys, NAMES["confidences"])
    read = (head, relation, tail, confidence)
    others = [name for number, name in enumerate(names) if number not in read]
    return Columns((head, relation, tail), confidence, tuple(filter(None, others)))


def _column(keys: list[str], names: Sequence[str]) -> int | None:
    """Return the first of the columns that have the surest of some names."""
    known = filter(keys.__contains__, names)
    return next(map(keys.index, known), None)


def _keys(names: Sequence[str]) -> list[str]:
    """Return the names of columns as `ROLES` has them: "head" of "Head Entity", "e1" of "e_1"."""
    keys = list(map(_key, names))
    roles = set(chain.from_iterable(ROLES.values()))
    for number, key in enumerate(keys):
        plain = _ADDITION.sub("", re.sub(r"_(?=\d)", "", key))
        if key not in roles and plain in roles and plain not in keys:
            keys[number] = plain
    return keys


def _key(name: str) -> str:
    """Return the name of a column in lower case: "start_id" of ":START_ID(Person)"."""
    key = re.sub(r"\(.*\)$", "", name.strip().lower()).lstrip("#")
    return re.sub(r"[\s-]+", "_", key.rpartition(":")[2].strip())


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


def confidence_of(
    columns: Columns, cells: Sequence[object], where: str
) -> float | None:
    """Return the probability that cells state, None of tables without a column of it.

    An empty cell states that the triple is certain.
    """
    if columns.confidence is None:
        return None
    value = cells[columns.confidence]
    confidence = probability(str(value).strip().replace(",", ".") or "1")
    if confidence is not None:
        return confidence
    raise UserError(
        f"{where}: the confidence is {value!r}; it must be a number from 0 to 1, such as 0.9. "
        "Divide percentages by 100, or rename a column that holds something else, such as weight."
    )


def probability(text: str) -> float | None:
    """Return the number from 0 to 1 that a text holds, None of another text."""
    with suppress(ValueError):
        number = float(text)
        if 0 <= number <= 1:
            return number
    return None


def listed(names: Iterable[str]) -> str:
    """Return names of a file for a message of one line."""
    return ", ".join(map(name_of_cell, names))


def cell_of_name(name: str) -> str:
    """Return the cell of which `name_of_cell` makes the name: its IRI where it must be exact."""
    if name_of_cell(name) == name:
        return name
    return NAMESPACE + quote(name, safe="")
