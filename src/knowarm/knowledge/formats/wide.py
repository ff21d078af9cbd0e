"""Wide tables: a row per thing and a column per property, which are recognized and not read."""

import json
import re
import shlex
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Mapping, Sequence
from pathlib import Path

from knowarm.knowledge.formats.files import open_compressed

_FIRST_COLUMNS = {
    "", "object", "item", "name", "entity", "thing", "id", "index", "class", "category", "concept",
    "noun", "word", "cue", "product", "title", "label", "key", "instance", "node", "term", "synset",
}  # fmt: skip
"""What the column of the things is called, which is the first."""
_IDENTIFIER = re.compile(r".*([a-z]Id|_id| id|ID)s?")
"""What the column of the numbers of things is called."""
_RELATION = re.compile(
    r".*[^\W\d_][_\-:/#. ].*|.*[a-z][A-Z].*|.*(s|of|for|in|on|at|to|by|with|from|is|has)"
)
"""How names of relations are spelled: of several words, or a verb or a preposition."""
_LONGEST = 60
"""Most letters of the name of a relation; longer ones are sentences, or IRIs."""
_FEW = 30
"""With this many rows or more, relations repeat, however they are spelled."""


def names_columns(cells: Sequence[str]) -> bool:
    """Return whether a row names the columns of a wide table: things come first."""
    first = cells[0].strip("_#")
    is_thing = first.casefold().removesuffix("s") in _FIRST_COLUMNS
    return is_thing or _IDENTIFIER.fullmatch(cells[0]) is not None


def is_wide(
    rows: int, different_heads: int, rows_by_relation: Mapping[str, int]
) -> bool:
    """Return whether three columns are a thing and two properties: nothing in them is a relation.

    Each thing has one row, and the values of the middle column differ nearly as often as the rows
    and are not spelled as relations are.
    """
    if rows < 3 or different_heads < 0.9 * rows or len(rows_by_relation) < 0.6 * rows:
        return False
    return rows >= _FEW or 2 * _rows_of_relations(rows_by_relation) < rows


def _rows_of_relations(rows_by_relation: Mapping[str, int]) -> int:
    """Return how many rows have a middle cell that is spelled as relations are."""
    count = 0
    for name, rows in rows_by_relation.items():
        is_iri_or_short = len(name) <= _LONGEST or ":" in name
        if is_iri_or_short and _RELATION.fullmatch(name):
            count += rows
    return count


def melt(path: Path, separator: str, skipped: int = 0) -> str:
    """Return the command that writes a row per property, which is then read."""
    options = [json.dumps(str(path), ensure_ascii=False)]
    if separator != ",":
        options.append(f"sep={json.dumps(separator)}")
    with open_compressed(path) as file:
        if file.read(2) in (BOM_UTF16_LE, BOM_UTF16_BE):
            options.append('encoding="utf-16"')
    if skipped:
        options.append(f"skiprows={skipped}")
    no_blanks = r'.replace(r"^\s*$", float("nan"), regex=True)'
    code = (
        f"import pandas; pandas.read_csv({', '.join(options)}, dtype=str, index_col=0, "
        f"skipinitialspace=True){no_blanks}.melt(ignore_index=False).dropna()"
        '.to_csv("triples.csv", index_label="head", header=["relation", "tail"])'
    )
    return (
        "If a line describes one thing and each column one of its properties, write a line per "
        f"property: python -c {shlex.quote(code)}"
    )
