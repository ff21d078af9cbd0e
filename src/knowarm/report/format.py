"""Numbers go in; the way people read them comes out."""

import math
from collections.abc import Callable
from typing import Any

MISSING = "–"
MINUS = "\u2212"
NARROW_SPACE = "\u202f"


def text(value: Any) -> str:
    """Anything as it is; yes and no for truth values."""
    if value is None or value == "":
        return MISSING
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value)


def number(value: float | None, decimals: int = 2) -> str:
    """A number with fixed decimals, a true minus and thousands apart."""
    if value is None or math.isnan(value):
        return MISSING
    shown = f"{value:,.{decimals}f}".replace(",", NARROW_SPACE)
    if not shown.strip("-0.\u202f"):
        shown = shown.lstrip("-")  # no negative zero
    return shown.replace("-", MINUS)


def percent(value: float | None, decimals: int = 1) -> str:
    """A share in 0..1 as per cent."""
    shown = number(None if value is None else value * 100, decimals)
    return shown if shown == MISSING else f"{shown}{NARROW_SPACE}%"


def points(value: float | None, decimals: int = 1) -> str:
    """A difference of shares as signed percentage points."""
    if value is None or math.isnan(value):
        return MISSING
    return signed(value * 100, decimals)


def signed(value: float | None, decimals: int = 2) -> str:
    """A number that shows its sign."""
    shown = number(value, decimals)
    if shown == MISSING or shown.startswith(MINUS) or not shown.strip("0.\u202f"):
        return shown
    return f"+{shown}"


def steps(value: float | None) -> str:
    """Environment steps, in k or M."""
    if value is None or math.isnan(value):
        return MISSING
    for size, unit in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{_short(value / size)}{NARROW_SPACE}{unit}"
    return _short(value)


def p_value(value: float | None) -> str:
    """A p-value; very small ones as a bound."""
    if value is None or math.isnan(value):
        return MISSING
    if value < 1e-3:
        return "< .001"
    return f"{value:.3f}".lstrip("0") if value < 1 else "1"


def integer(value: float | None) -> str:
    """A count with thousands apart."""
    return number(value, 0)


def _short(value: float) -> str:
    shown = f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    return shown.replace("-", MINUS)


def decimals(count: int) -> Callable[[Any], str]:
    """`number` with so many decimals."""
    return lambda value: number(value, count)


FORMATS: dict[str, Callable[[Any], str]] = {
    "text": text,
    "integer": integer,
    "number": number,
    "number1": decimals(1),
    "number3": decimals(3),
    "signed": signed,
    "percent": percent,
    "points": points,
    "steps": steps,
    "p": p_value,
    "path": text,
}
"""Formats a table column can name."""
