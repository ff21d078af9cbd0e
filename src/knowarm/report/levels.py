"""A group of runs and the name of a number go in; its mean over training seeds comes out."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from knowarm.report.study import Group
from knowarm.statistics import Interval, bootstrap


def level(group: Group, key: str) -> Interval | None:
    """Mean of one number over a group's runs.

    The interval is a bootstrap over training seeds. A single run has no seeds to resample: its
    interval, where the summary holds one, is over episodes and speaks of that network alone.

    Args:
        group: the runs.
        key: name of a number in ``summary.json``.

    Returns:
        The interval, or None when no run has the number.
    """
    return _level(group, lambda summary: summary, key)


def part_level(group: Group, part: str, name: str, key: str) -> Interval | None:
    """`level` of one target (``part="per_target"``) or facet (``per_facet``)."""
    return _level(group, lambda summary: summary.get(part, {}).get(name, {}), key)


def own_level(summary: Mapping[str, Any], key: str) -> Interval | None:
    """A number of one evaluation with its interval over episodes, where there is one."""
    value = summary.get(key)
    if value is None:
        return None
    low, high = summary.get(f"{key}_low", value), summary.get(f"{key}_high", value)
    return Interval(float(value), float(low), float(high))


def cells(key: str, interval: Interval | None) -> dict[str, float | None]:
    """An interval as the three cells of a table row."""
    if interval is None:
        return {key: None, f"{key}_low": None, f"{key}_high": None}
    return {key: interval.estimate, f"{key}_low": interval.low, f"{key}_high": interval.high}


def _level(
    group: Group, pick: Callable[[Mapping[str, Any]], Mapping[str, Any]], key: str
) -> Interval | None:
    summaries = [pick(each.summary) for each in group.judged()]
    found = [summary for summary in summaries if summary.get(key) is not None]
    if not found:
        return None
    if len(found) == 1:
        return own_level(found[0], key)
    return bootstrap([np.array([float(summary[key]) for summary in found])])
