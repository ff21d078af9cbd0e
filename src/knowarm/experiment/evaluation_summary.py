"""Columns of played episodes go in; the paper's table of one evaluation comes out."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from knowarm.statistics import Interval, bootstrap, wilson

Columns = Mapping[str, np.ndarray]
"""One (n,) array a column, as `evaluation_files.EPISODE_COLUMNS` describes them."""


def summarize(episodes: Columns) -> dict[str, Any]:
    """Numbers of the paper's post-training evaluation (section 4.2.4), with intervals.

    Args:
        episodes: the columns of `evaluation_files.EPISODE_COLUMNS`, n at least 1.

    Returns:
        Flat numbers of all episodes, and the same under ``per_target`` and ``per_facet``:
        ``return_*``, ``length_*`` and ``failure_distance_*`` (mean, std, max; episodes without
        success; None where there were none), ``accuracy`` (the paper's: final distance alone),
        ``success`` (distance and angle at once) and ``success_wide`` (the wider angle), each of
        these three with Wilson's 95 % interval. ``return_mean`` and ``length_mean`` carry
        bootstrap intervals over episodes. Standard deviations are those of the sample (n - 1).
    """
    summary = numbers(episodes)
    targets, facets = episodes["target"], episodes["facet"]
    summary["per_target"] = {
        str(name): numbers(_where(episodes, targets == name)) for name in sorted(set(targets))
    }
    summary["per_facet"] = {
        str(name): numbers(_where(episodes, facets == name)) for name in sorted(set(facets))
    }
    return summary


def numbers(episodes: Columns) -> dict[str, Any]:
    """The flat numbers of `summarize` for some episodes."""
    count = len(episodes["return"])
    failures = episodes["distance_m"][~episodes["success"]]
    values: dict[str, Any] = {"episodes": count}
    for name in ("return", "length"):
        values[f"{name}_mean"] = float(np.mean(episodes[name]))
        values[f"{name}_std"] = _spread(episodes[name])
        _add(values, f"{name}_mean", bootstrap([episodes[name]], repetitions=2_000))
    for name in ("accuracy", "success", "success_wide"):
        column = "accurate" if name == "accuracy" else name
        share = wilson(int(np.count_nonzero(episodes[column])), count)
        values[name] = share.estimate
        _add(values, name, share)
    values["failures"] = len(failures)
    values["failure_distance_mean"] = float(np.mean(failures)) if len(failures) else None
    values["failure_distance_std"] = _spread(failures) if len(failures) else None
    values["failure_distance_max"] = float(np.max(failures)) if len(failures) else None
    values["distance_mean"] = float(np.mean(episodes["distance_m"]))
    values["angle_mean"] = float(np.mean(episodes["angle_deg"]))
    return values


def _where(episodes: Columns, chosen: np.ndarray) -> Columns:
    return {name: column[chosen] for name, column in episodes.items()}


def _spread(values: np.ndarray) -> float:
    return float(np.std(values, ddof=1)) if len(values) > 1 else 0.0


def _add(values: dict[str, Any], name: str, interval: Interval) -> None:
    values[f"{name}_low"] = interval.low
    values[f"{name}_high"] = interval.high
