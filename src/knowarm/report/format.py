"""Formatting for people: numbers, enumerations, names, colours of agents, settings that differ."""

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from knowarm.experiment.agents import AGENTS
from knowarm.statistics import Interval

MISSING, MINUS, NARROW_SPACE = "–", "\u2212", "\u202f"
# Palette classes for agents without a colour of their own, in the order in which they are used.
SPARE_COLOURS = ("c-navy", "c-gold", "c-teal", "c-purple", "c-pink", "c-brown", "c-grey")


def text(value: Any) -> str:
    """Format any value; truth values as yes and no."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return MISSING if value is None or value == "" else str(value)


def number(value: float | None, decimals: int = 2) -> str:
    """Format a number with fixed decimals, a typographic minus and separated thousands."""
    if value is None or math.isnan(value):
        return MISSING
    shown = f"{value:,.{decimals}f}".replace(",", NARROW_SPACE)
    if not shown.strip("-0.\u202f"):
        shown = shown.lstrip("-")  # no negative zero
    return shown.replace("-", MINUS)


integer = partial(number, decimals=0)


def percent(value: float | None, decimals: int = 1) -> str:
    """Format a fraction in 0..1 in per cent."""
    shown = number(None if value is None else value * 100, decimals)
    return shown if shown == MISSING else f"{shown}{NARROW_SPACE}%"


def signed(value: float | None, decimals: int = 2) -> str:
    """Format a number with its sign."""
    shown = number(value, decimals)
    unsigned = shown == MISSING or shown.startswith(MINUS) or not shown.strip("0.\u202f")
    return shown if unsigned else f"+{shown}"


def points(value: float | None, decimals: int = 1) -> str:
    """Format a difference of fractions in signed percentage points."""
    return signed(None if value is None else value * 100, decimals)


def steps(value: float | None) -> str:
    """Format environment steps in k, M or G."""
    if value is None or math.isnan(value):
        return MISSING

    def three_digits(value: float) -> str:
        shown = f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
        return shown.replace("-", MINUS)

    for size, unit in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(float(f"{value:.3g}")) >= size:
            return f"{three_digits(value / size)}{NARROW_SPACE}{unit}"
    return three_digits(value)


def p_value(value: float | None) -> str:
    """Format a p-value; values below .001 as a bound."""
    if value is None or math.isnan(value):
        return MISSING
    if value < 1e-3:
        return "< .001"
    return f"{value:.3f}".lstrip("0") if value < 1 else "1"


def ends(value: Interval, form: Callable[[float], str]) -> str:
    """Format the ends of an interval, or the runs that are too few for one.

    Equal values, as of equal seeds, have none.
    """
    if value.runs:
        return f"training seeds {listed([form(each) for each in value.runs])}"
    shown = f"95 % interval {form(value.low)} to {form(value.high)}"
    return shown if value.low < value.high else "no interval, because all values are equal"


FORMATS: dict[str, Callable[[Any], str]] = {  # of table columns, by name
    **{"text": text, "path": text, "integer": integer, "number": number},
    **{"number1": partial(number, decimals=1), "number3": partial(number, decimals=3)},
    **{"signed": signed, "percent": percent, "points": points, "steps": steps, "p": p_value},
}


def listed(names: Sequence[str], conjunction: str = "and") -> str:
    """Join names to an enumeration: "a, b and c"."""
    return f" {conjunction} ".join([", ".join(names[:-1]), names[-1]] if names[1:] else names)


def counted(number: int, noun: str) -> str:
    """Format a count with its noun in the singular or plural."""
    return f"{number} {noun}" + ("" if number == 1 else "s")


def facet(name: str) -> str:
    """Format a target or facet: "cereal_box/light_blue" as "cereal box, light blue"."""
    return name.replace("_", " ").replace("/", ", ")


def slugs(names: Iterable[str]) -> dict[str, str]:
    """Return one slug per name, safe in file names and addresses, no two alike."""
    by_name: dict[str, str] = {}
    for name in names:
        base = re.sub(r"[^a-z0-9+]+", "-", name.lower()).strip("-") or "x"
        slug, suffix = base, 2
        while slug in by_name.values():
            slug, suffix = f"{base}-{suffix}", suffix + 1
        by_name[name] = slug
    return by_name


def palette(names: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Choose one palette class per (group, agent): the registered one, or a spare one."""
    chosen: dict[str, str] = {}
    for name, agent in names:
        registered = AGENTS[agent].colour if agent in AGENTS else None
        taken = set(chosen.values())
        if not registered or registered in taken:
            free = [spare for spare in SPARE_COLOURS if spare not in taken]
            registered = (free or SPARE_COLOURS)[0 if free else len(chosen) % len(SPARE_COLOURS)]
        chosen[name] = registered
    return chosen


def differing(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the names whose values are not the same everywhere."""
    texts = [{n: json.dumps(v, sort_keys=True) for n, v in each.items()} for each in settings]
    names = sorted({name for each in settings for name in each})
    return [name for name in names if len({each.get(name, "null") for each in texts}) > 1]
