"""Escapes: how each output format holds text that a stranger wrote."""

import re

from knowarm.errors import printable

_FORMULA = re.compile(
    r"(^|[,;|\t\r\n])([^\w\t\r\n!-/:-@\[-`{-~]*)(?=[=+\-@\uff1d\uff0b\uff0d\uff20])"
)
"""Where a spreadsheet begins a cell, also with another separator than the comma, and a formula,
perhaps behind what is neither seen nor read."""
_NUMBER = re.compile(r"[-+]?[0-9.]+(e[-+]?[0-9]+)?")
_MARKDOWN = re.compile(r"[\\`*_\[\]<>!|&~$\"']")


def csv_cell(text: str) -> str:
    """Return text that no spreadsheet takes for a formula; numbers stay."""
    if _NUMBER.fullmatch(text):
        return text
    return _FORMULA.sub(r"\1\2'", text)


def markdown(text: str) -> str:
    """Return text in one line without links, images, markup and cells of a table."""
    line = " ".join(printable(text).split())
    return _MARKDOWN.sub(lambda match: f"&#{ord(match[0])};", line)


_LATEX = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "\u2212": "$-$",
        "\u2013": "--",
        "\u00b0": r"$^\circ$",
        **{mark: f"\\{mark}" for mark in "{}$&#_%"},
    }
)


def latex(text: str) -> str:
    """Return text in one line as LaTeX prints it in text mode: no command, cell or comment."""
    return " ".join(printable(text).split()).translate(_LATEX)
