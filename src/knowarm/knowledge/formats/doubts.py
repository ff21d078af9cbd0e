"""Tables that hold hardly triples: a row per thing, marks around rows, names of columns above."""

import json
import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections import Counter
from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path

from knowarm.errors import UserError, warn
from knowarm.knowledge.formats.columns import NAMES, listed
from knowarm.knowledge.formats.files import open_compressed, python
from knowarm.knowledge.graph.graph import Triple

_IDENTIFIER = re.compile(r".*([a-z]Id|_id| id|ID)s?")
"""What the column of the numbers of things is called."""
_RELATION = re.compile(
    r"(?=.{1,60}$|.*:)"  # longer ones are sentences, or IRIs
    r"(?:.*[^\W\d_][_\-:/#. ].*|.*[a-z][A-Z].*|.*(s|of|for|in|on|at|to|by|with|from|is|has))"
)
"""How names of relations are spelled: of several words, or a verb or a preposition."""
_FEW = 30
"""With this many rows or more, relations repeat, however they are spelled."""
_NUMBER = re.compile(r"[-+]?\d+(?:[.,]\d+)?")
_BRACKETS = ("()", "[]", "{}", "⟨⟩", "（）")
_MARK = re.compile(r"(?!_:|<[^<>]*>$)(?:[^\w/:#\"'@.$?!&%~(\[{]|_(?=.*_$))")
"""Mark with which a head begins, and names do not."""


def refuse_marks(path: Path, rows: list[Triple]) -> None:
    """Refuse a table if most of its rows have brackets, or all begin with one mark.

    They would become parts of names.
    """
    marks = set()
    in_brackets = 0
    for head, _, tail in rows:
        mark = _MARK.match(head)
        marks.add(mark[0] if mark else "")
        in_brackets += any(_spans(pair, head, tail) for pair in _BRACKETS)
    what = ""
    if 2 * in_brackets > len(rows):
        what = "most rows have brackets around them"
    elif len(rows) > 1 and len(marks) == 1 and marks != {""}:
        what = f"all rows begin with {marks.pop()!r}"
    if what:
        raise UserError(
            f"{path}: {what}, which would become part of names. Write rows of three names, "
            "such as mug,usedFor,drinking."
        )


def _spans(pair: str, head: str, tail: str) -> bool:
    """Return whether a bracket opens in the head of a row and closes in its tail."""
    opening, closing = map(head.count, pair)
    opened_in_tail, closed_in_tail = map(tail.count, pair)
    return opening > closing and closed_in_tail > opened_in_tail


def doubt(where: str, rows: list[Triple], if_wide: str) -> None:
    """Warn of rows that are hardly triples; refuse them if the first names columns.

    Args:
        where: the line of the first row.
        rows: the first rows of a table, of which none is known to name columns.
        if_wide: what to do if a row holds a thing and its properties.
    """
    first = rows[0]
    heads = set(map(itemgetter(0), rows))
    relations = Counter(map(itemgetter(1), rows))
    occurs_again = not all(map(set(first).isdisjoint, rows[1:]))
    is_wide = _is_wide(len(rows), len(heads), relations)
    is_header = not occurs_again and _names_columns(first)
    are_numbers = len(rows) > 1 and all(map(_NUMBER.fullmatch, relations))
    if is_header and not are_numbers and (is_wide or 1 < len(rows) == len(heads)):
        raise UserError(
            f"{where}: {listed(first)} name columns, but not which are head, relation and tail; "
            f"name them so, or write head,relation,tail above triples. {if_wide}."
        )
    if is_wide or are_numbers:
        if occurs_again or are_numbers:
            if_wide = (
                "If the middle column is no relation, name the columns in a first line, such as "
                "object,use,material"
            )
        values = list(relations)[not occurs_again :]
        examples = ", ".join(values[:3])
        warn(
            f"{where}: {examples} were read as relations, but hardly one of them "
            f"occurs again, or they are numbers. {if_wide}."
        )
    elif not occurs_again and max(3, len(relations)) < len(rows):
        warn(
            f"{where}: {listed(first)} was read as a triple, but no word of it occurs again. If "
            "these are names of columns, write head,relation,tail."
        )


def _is_wide(rows: int, different_heads: int, relations: Counter[str]) -> bool:
    """Return whether three columns are a thing and two properties: nothing in them is a relation.

    Each thing has one row, and the values of the middle column differ nearly as often as the rows
    and are not spelled as relations are.
    """
    if rows < 3 or different_heads < 0.9 * rows:
        return False
    if len(relations) < 0.6 * rows:
        return False
    spelled = list(filter(_RELATION.fullmatch, relations.elements()))
    return rows >= _FEW or 2 * len(spelled) < rows


def _names_columns(cells: Sequence[str]) -> bool:
    """Return whether a row names the columns of a wide table: things come first."""
    first = cells[0].strip("_#")
    is_thing = first.casefold().removesuffix("s") in NAMES["things"]
    return is_thing or _IDENTIFIER.fullmatch(cells[0]) is not None


def melt(path: Path, separator: str, skipped: int = 0) -> str:
    """Return the command that writes a row per property, which is then read."""
    options = ""
    if separator != ",":
        options += f"sep={json.dumps(separator)}, "
    with open_compressed(path) as file:
        if file.read(2) in (BOM_UTF16_LE, BOM_UTF16_BE):
            options += 'encoding="utf-16", '
    if skipped:
        options += f"skiprows={skipped}, "
    no_blanks = r'.replace(r"^\s*$", float("nan"), regex=True)'
    code = (
        f"import pandas; pandas.read_csv(<file>, {options}dtype=str, index_col=0, "
        f"skipinitialspace=True){no_blanks}.melt(ignore_index=False).dropna()"
        '.to_csv(<made>, index_label="head", header=["relation", "tail"])'
    )
    return (
        "If a line describes one thing and each column one of its properties, write a line per "
        f"property: {python(code, path, 'triples.csv')}"
    )
