"""Triples as people and language models write them: in brackets, in lists, with arrows, in tables.

A line is a triple if something sets it off from prose and from tables: brackets around it, a bullet
or a number before it, arrows between its cells, or the bars of a Markdown table.
"""

import ast
import csv
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from operator import itemgetter
from pathlib import Path

from knowarm.errors import UserError, warn
from knowarm.knowledge.formats.columns import ROLES, columns_of
from knowarm.knowledge.formats.files import text_lines
from knowarm.knowledge.formats.tables import Row, read_rows
from knowarm.knowledge.graph.graph import KnowledgeGraph

Cells = list[str]
"""Head, relation, tail and further cells of a line."""

_BULLET = re.compile(
    r"\s*(?:>\s*)*"  # as Markdown quotes
    r"(?:(?:[^\w\s\"'`(\[{<⟨/:#@|$=.]{1,2}|\(?\d{1,5}[.):]|\[\d{1,5}\]|[A-Za-z][)])\s+)?"
    r"(?:\[[ xX]\]\s+)?(?:\w+ ?\d+[.):]\s+(?=[(\[<{⟨]))?"
)
"""What stands before an item: a bullet, a number or a letter, a box, "Triple 1:"."""
_ARROW = re.compile(r"\s*(?:[-=]+>|[→⟶⇒])\s*")
_SPACED_ARROW = re.compile(r"\s(?:[-=]+>|[→⟶⇒])|(?:[-=]+>|[→⟶⇒])\s")
_EDGE = re.compile(
    r"\s*(?:-+\s*\[\s*:?(.+?)\s*\]|--+\s*([^\s>-].*?))\s*(?:[-=]+>|[→⟶⇒])"
)
"""Relation in an arrow: of "mug -[usedFor]-> drinking" and "mug --usedFor-> ..."."""
_RULE = re.compile(r"\s*[|+]?\s*:?-{2,}:?\s*(?:[|+]\s*:?-{2,}:?\s*)*[|+]?\s*")
"""Line below the names of the columns of a Markdown table."""
_FENCE = re.compile(r"\s*(?:```|~~~)\s*([\w+-]*)")
_WRAPPER = re.compile(r"\s*(?:[\w ]+=\s*)?[\[\]{}()]\s*,?\s*")
"""First or last line of a list of a programming language."""
_NAMES = re.compile(r"[\s,;]*".join(["<([^<>=?!/,;|]+)>"] * 3) + r"[\s,;.]*")
"""Three names, each in angle brackets."""
_GROUP = re.compile(r"\([^()]*\)|\[[^\[\]]*\]|<[^<>]*>|\{[^{}]*\}|⟨[^⟨⟩]*⟩")
_BETWEEN = re.compile(r"[\s,;.\[\](){}]*")
_ROLE = re.compile(r"(\w+)\s*[:=]\s*(.+)")
_EMPHASIS = re.compile(r"(\*\*|\*|`|\"|')(.+)\1|“(.+)”|‘(.+)’")
_PAIRS = {"(": ")", "[": "]", "<": ">", "{": "}", "⟨": "⟩"}
_SEPARATORS = ("\t", "|", ";", ",")
_TEXTS = ("", "text", "txt", "plaintext", "plain", "csv", "tsv", "markdown", "md")
"""Languages of code blocks that hold triples of names."""


def looks_written(beginning: str) -> bool:
    """Return whether a text has a code block, or more triples that are set off than table rows."""
    lines = list(filter(str.strip, beginning.splitlines()))
    if any(map(_FENCE.match, lines)):
        return True
    if lines and _named_columns(lines[0]):
        lines = lines[1:]
    triples = 0
    rows = 0
    has_rule = any(map(_is_rule, lines))
    for line in lines:
        if _triples_of_line(line, has_rule):
            triples += 1
        elif not _is_rule(line) and not _is_cut(line):
            separators = map(line.count, _SEPARATORS)
            rows += max(separators) >= 2
    return triples > rows


def read_written(path: Path) -> KnowledgeGraph:
    """Read the lines that are set off as triples; the others are left out with a warning.

    The first may name the columns (see `ROLES`). Code blocks hold triples of names, too.
    """
    as_triples = "Write a line per fact: head, relation, tail"
    return read_rows(path, _written_rows(path), as_triples)


def _written_rows(path: Path) -> Iterator[Row]:
    """Yield the cells of the lines that are triples."""
    lines = list(text_lines(path))
    following = list(map(itemgetter(1), lines))
    has_rule = any(map(_is_rule, following))
    # Also without their bullets
    has_brackets = any(_triples_of_line(line, has_brackets=True) for line in following)
    prose = []
    header: Cells = []
    count = 0
    is_block = False
    for (number, line), below in zip(lines, [*following[1:], ""], strict=False):
        where = f"{path}, line {number}"
        fence = _FENCE.match(line)
        if fence is not None:
            is_block = not is_block
            if is_block and fence[1].lower() not in _TEXTS:
                raise UserError(
                    f"{where}: a code block in {fence[1]} begins here. Save what is in the block "
                    "as a file of its own."
                )
            continue
        if _is_rule(line) or _WRAPPER.fullmatch(line) or not line.strip():
            continue
        triples = _triples_of_line(line, has_rule, has_brackets, is_block)
        if not triples and not count:
            triples = _named_columns(line)
        if not triples and _is_cut(line):
            raise UserError(
                f"{where}: a bracket is not closed: {line.strip()[:60]}. Correct it."
            )
        if not triples:
            prose.append(f"line {number}: {line.strip()[:60]}")
        if triples and _is_rule(below) and ("|" in below or not count):
            _check_header(where, triples[0], header)
            if header:
                continue
            header = triples[0]
        for cells in triples:
            count += 1
            yield where, cells
    if prose and count:
        warn(
            f"{path}: left out are {len(prose)} lines without a triple, such as {prose[0]}"
        )


def _check_header(where: str, names: Cells, first: Cells) -> None:
    """Refuse names above the line of a Markdown table that name no columns, or not the first."""
    if first and names != first:
        raise UserError(
            f"{where}: another table begins, with the columns {', '.join(names)}. "
            "Save it as a file of its own."
        )
    if columns_of(tuple(names), where) is None:
        raise UserError(
            f"{where}: {', '.join(names)} name columns, but not which are head, "
            f"relation and tail. Name them {', '.join(ROLES)}, and write a row per fact."
        )


def _named_columns(line: str) -> list[Cells]:
    """Return the cells of a line that names columns without being set off."""
    cells = _row(line)
    return [cells] if _columns(cells) else []


def _columns(names: Iterable[object]) -> tuple[int, ...]:
    """Return the columns of head, relation and tail that names tell, () without."""
    with suppress(UserError):
        columns = columns_of(tuple(map(str, names)), "")
        if columns is not None:
            return columns.triple
    return ()


def _is_cut(line: str) -> bool:
    """Return whether a bracket opens a line and is not closed."""
    text = line.strip()
    return text.startswith(tuple(_PAIRS)) and "," in text and _closing(text) < 0


def _is_rule(line: str) -> bool:
    return _RULE.fullmatch(line) is not None and not set("|+").isdisjoint(line)


def _triples_of_line(
    line: str,
    has_rule: bool = False,
    has_brackets: bool = False,
    is_block: bool = False,
) -> list[Cells]:
    """Return the cells of the triples in a line, none if it is not set off.

    Args:
        line: the line.
        has_rule: the file has a Markdown table, whose rows need no bar at their ends.
        has_brackets: its triples have brackets, so that items of lists without are prose.
        is_block: it lies in a block of code, which sets it off.
    """
    if _is_rule(line) or _WRAPPER.fullmatch(line):
        return []
    text = _BULLET.sub("", line, count=1).strip()
    is_item = text != line.strip() and not has_brackets
    text = _without_emphasis(text)
    if text.startswith("|") and text.endswith("|") and len(text) > 1:
        return [_split(text[1:-1], "|")]
    names = _NAMES.fullmatch(text)
    if names is not None:
        return [list(names.groups())]
    triples = []
    for group in _groups(text):
        triples += _triples_of_group(group)
    if triples:
        return triples
    cells = _row(text)
    if _ARROW.search(text) and (_SPACED_ARROW.search(text) or len(cells) != 3):
        return list(filter(None, [_cells_of_arrows(text)]))
    values = _without_roles(cells)
    is_set_off = is_item or is_block or (has_rule and "|" in text)
    if not values and cells and is_set_off:
        values = _without_full_stop(cells, is_item)
    return list(filter(None, [values]))


def _groups(text: str) -> list[str]:
    """Return the bracketed parts of a line that holds nothing else."""
    text = text.rstrip(",;. \t")
    groups = _GROUP.findall(text)
    if groups and _BETWEEN.fullmatch(_GROUP.sub("", text)):
        return groups
    if _closing(text) == len(text) - 1:
        return [text]
    return []


def _closing(text: str) -> int:
    """Return where the bracket closes with which a text begins, -1 if nowhere."""
    pair = _PAIRS.get(text[:1])
    if pair is None:
        return -1
    depth = 0
    for index, mark in enumerate(text):
        depth += (mark == text[0]) - (mark == pair)
        if depth == 0:
            return index
    return -1


def _triples_of_group(group: str) -> list[Cells]:
    """Return the cells in brackets, or in the brackets in them; none if there is only one."""
    with suppress(SyntaxError, ValueError, RecursionError, MemoryError):
        values = ast.literal_eval(group)
        if isinstance(values, dict):
            return list(filter(None, [_values_of_roles(values)]))
        if isinstance(values, tuple | list):
            if not all(isinstance(value, tuple | list) for value in values):
                values = [values]
            return [list(map(str, value)) for value in values]
    inside = group[1:-1].strip()
    if _ARROW.search(inside):
        return list(filter(None, [_cells_of_arrows(inside)]))
    cells = _row(inside, least=2)
    return list(filter(None, [_without_roles(cells) or cells]))


def _cells_of_arrows(text: str) -> Cells:
    """Return the cells between arrows: of "mug -> usedFor -> drinking", "(mug)-[:IN]->(box)"."""
    cells = _ARROW.split(_EDGE.sub(r" -> \1\2 -> ", text))
    if len(cells) != 3 or "{" in text:
        return []
    plain = []
    for cell in map(str.strip, cells):
        if _closing(cell) == len(cell) - 1:
            cell = cell[1:-1].strip()
        plain.append(_without_emphasis(cell))
    return plain


def _row(text: str, least: int = 3) -> Cells:
    """Return the cells between the first of the separators that part a text, [] without."""
    rows = (_split(text, separator) for separator in _SEPARATORS)
    return next((cells for cells in rows if len(cells) >= least), [])


def _split(text: str, separator: str) -> Cells:
    """Split a text by the rules of CSV; cells without quotes, emphasis and blanks around them."""
    with suppress(csv.Error):
        (cells,) = csv.reader([text], delimiter=separator, skipinitialspace=True)
        return list(map(_without_emphasis, map(str.strip, cells)))
    return []


def _without_emphasis(text: str) -> str:
    """Return a text without the quotes or marks of Markdown around the whole of it."""
    match = _EMPHASIS.fullmatch(text)
    if match is None:
        return text
    inside = match[match.lastindex or 0]
    if match[1] and match[1] in inside:
        return text
    return _without_emphasis(inside)


def _without_roles(cells: Cells) -> Cells:
    """Return the values of cells such as "Subject: mug", in order; none if they are no such."""
    values = {}
    for match in map(_ROLE.fullmatch, cells):
        if match is None:
            return []
        values[_without_emphasis(match[1])] = _without_emphasis(match[2])
    return _values_of_roles(values)


def _values_of_roles(values: Mapping[str, object]) -> Cells:
    """Return the values of head, relation and tail in order; none if the keys name no such."""
    texts = list(map(str, values.values()))
    return list(map(texts.__getitem__, _columns(values)))


def _without_full_stop(cells: Cells, is_item: bool) -> Cells:
    """Return cells without the full stop behind an item of a list."""
    last = cells[-1]
    if is_item and last.endswith(".") and "." not in last[:-1]:
        return [*cells[:-1], last[:-1]]
    return cells
