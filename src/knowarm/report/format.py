"""Formatting for people: numbers, enumerations, names, colours of agents, settings that differ."""

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial, wraps
from typing import Any

from knowarm.experiment.agents import AGENTS
from knowarm.statistics import Interval

MISSING = "–"
MINUS = "\u2212"
NARROW_SPACE = "\u202f"
# Palette classes for agents without a colour of their own, in the order in which they are used.
SPARE_COLOURS = (
    "c-navy",
    "c-gold",
    "c-teal",
    "c-purple",
    "c-pink",
    "c-brown",
    "c-grey",
)


def text(value: Any) -> str:
    """Format any value; truth values as yes and no."""
    if value is None or value == "":
        return MISSING
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value)


def _known(form: Callable[..., str]) -> Callable[..., str]:
    """Let a format of numbers show None and NaN as missing."""

    @wraps(form)
    def formatted(value: float | None, *options: int, **named: int) -> str:
        if value is None or math.isnan(value):
            return MISSING
        return form(value, *options, **named)

    return formatted


def _is_zero(formatted: str) -> bool:
    return not formatted.strip(f"-0.{NARROW_SPACE}")


@_known
def number(value: float, decimals: int = 2) -> str:
    """Format a number with fixed decimals, a typographic minus and separated thousands."""
    formatted = f"{value:,.{decimals}f}".replace(",", NARROW_SPACE)
    if _is_zero(formatted):
        return formatted.lstrip("-")  # no negative zero
    return formatted.replace("-", MINUS)


integer = partial(number, decimals=0)


@_known
def percent(value: float, decimals: int = 1) -> str:
    """Format a fraction in 0..1 in per cent."""
    return f"{number(value * 100, decimals)}{NARROW_SPACE}%"


@_known
def signed(value: float, decimals: int = 2) -> str:
    """Format a number with its sign."""
    formatted = number(value, decimals)
    if formatted.startswith(MINUS) or _is_zero(formatted):
        return formatted
    return f"+{formatted}"


@_known
def points(value: float, decimals: int = 1) -> str:
    """Format a difference of fractions in signed percentage points."""
    return signed(value * 100, decimals)


@_known
def steps(value: float) -> str:
    """Format environment steps in k, M or G."""
    rounded = abs(float(f"{value:.3g}"))
    for size, unit in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if rounded >= size:
            return f"{_three_digits(value / size)}{NARROW_SPACE}{unit}"
    return _three_digits(value)


def _three_digits(value: float) -> str:
    """Format a number with three significant digits, without an exponent."""
    style = ".3g" if abs(value) < 1000 else ".0f"
    return f"{value:{style}}".replace("-", MINUS)


@_known
def p_value(value: float) -> str:
    """Format a p-value; values below .001 as a bound."""
    if value < 1e-3:
        return "< .001"
    if value >= 1:
        return "1"
    return f"{value:.3f}".lstrip("0")


def ends(value: Interval, form: Callable[[float], str]) -> str:
    """Format the ends of an interval, or the runs that are too few for one.

    Equal values, as of equal seeds, have none.
    """
    if value.runs:
        return f"training seeds {listed([form(run) for run in value.runs])}"
    if value.low < value.high:
        return f"95 % interval {form(value.low)} to {form(value.high)}"
    return "no interval, because all values are equal"


FORMATS: dict[str, Callable[[Any], str]] = {
    "text": text,
    "path": text,
    "integer": integer,
    "number": number,
    "number1": partial(number, decimals=1),
    "number3": partial(number, decimals=3),
    "signed": signed,
    "percent": percent,
    "points": points,
    "steps": steps,
    "p": p_value,
}
"""Formats of table columns, by name."""


def listed(names: Sequence[str], conjunction: str = "and") -> str:
    """Join names to an enumeration: "a, b and c"."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {conjunction} {names[-1]}"


def counted(number: int, noun: str) -> str:
    """Format a count with its noun in the singular or plural."""
    if number == 1:
        return f"1 {noun}"
    return f"{number} {noun}s"


def facet(name: str) -> str:
    """Format a target or facet: "cereal_box/light_blue" as "cereal box, light blue"."""
    return name.replace("_", " ").replace("/", ", ")


def slugs(names: Iterable[str]) -> dict[str, str]:
    """Return one slug per name, safe in file names and addresses, no two alike."""
    by_name: dict[str, str] = {}
    for name in names:
        base = re.sub(r"[^a-z0-9+]+", "-", name.lower()).strip("-") or "x"
        slug = base
        suffix = 2
        while slug in by_name.values():
            slug = f"{base}-{suffix}"
            suffix += 1
        by_name[name] = slug
    return by_name


def palette(names: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Choose one palette class per (group, agent): the registered one, or a spare one."""
    chosen: dict[str, str] = {}
    for name, agent in names:
        colour = AGENTS[agent].colour if agent in AGENTS else None
        taken = chosen.values()
        if not colour or colour in taken:
            repeated = SPARE_COLOURS[len(chosen) % len(SPARE_COLOURS)]
            free = (spare for spare in SPARE_COLOURS if spare not in taken)
            colour = next(free, repeated)
        chosen[name] = colour
    return chosen


def differing(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the names whose values are not the same everywhere; a missing one counts as None."""
    different = []
    for name in sorted(set[str]().union(*settings)):
        values = {json.dumps(setting.get(name), sort_keys=True) for setting in settings}
        if len(values) > 1:
            different.append(name)
    return different
