"""Measures of every evaluation: each number is named, computed and described here, once."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from knowarm.measures import Columns, Measure
from knowarm.statistics import Interval, bootstrap, wilson
from knowarm.world.tasks import task_measures

AGAIN = "Evaluate the run again."
"""Remedy for a damaged file of an evaluation."""
WIDE_ANGLE_DEG = 20.0
"""Largest angle of ``success_wide`` [deg], unless that of ``success`` is larger."""

Number = float | Interval
Numbers = dict[str, Number]


def _share(values: np.ndarray) -> Interval:
    return wilson(int(np.count_nonzero(values)), len(values))


STATISTICS: dict[str, Callable[[np.ndarray], Number]] = {
    "share": _share,
    "mean": partial(bootstrap, repetitions=2_000),
    "average": np.mean,
    "std": lambda values: np.std(values, ddof=1) if len(values) > 1 else 0.0,
    "max": np.max,
    "count": len,
}


def _choice_corrected(episodes: Columns) -> Interval | None:
    """Return the share of right choices: 0 for a choice at random, 1 if all are right."""
    if "chance" not in episodes:
        return None
    choice, chance = _share(episodes["choice_correct"]), episodes["chance"][0]
    ends = (choice.estimate, choice.low, choice.high)
    return Interval(*(float((end - chance) / (1 - chance)) for end in ends))


def _success_corrected(episodes: Columns) -> float | None:
    """Return the success; 0 for an agent that reaches as often what it chooses at random."""
    if "chance" not in episodes:
        return None
    success, right = episodes["success"], episodes["choice_correct"]
    chance = episodes["chance"][0]
    guessed = chance * (success[right].mean() if right.any() else 0.0)
    return float((success.mean() - guessed) / (1 - chance))


def _switched(episodes: Columns) -> Interval | None:
    """Return the share of the new answer among the episodes that ended at the new or the old."""
    right, old = episodes.get("choice_correct"), episodes.get("chose_old_answer")
    if right is None or old is None or not (either := right | old).any():
        return None
    return _share(right[either])


def _saw(is_so: Callable[[np.ndarray], np.ndarray]) -> Callable[[Columns], Interval | None]:
    """Return the share of first images in which an agent sees so many answers."""
    name = "visible_answers"
    return lambda episodes: _share(is_so(episodes[name])) if name in episodes else None


def _asks(episodes: Columns) -> Interval | None:
    """Return the share of first images in which an agent sees not exactly one candidate."""
    return _saw(lambda count: count != 1)(episodes) if "covered" in episodes else None


_points: dict[str, Any] = {"format": "points", "compute": lambda _: None}  # a probe computes it
_metres: dict[str, Any] = {"format": "number3"}
_failed = _metres | {"among": lambda episodes: ~episodes["success"]}
_CORRECTED = "corrected for chance"

_ALL = (
    Measure("episodes", "episodes", "return", "count", format="integer"),
    Measure("success", "success", "success", about="distance and angle at one step"),
    Measure("success_wide", f"success, {WIDE_ANGLE_DEG:g}°", "success_wide", detail=True),
    Measure("accuracy", "accuracy", "accurate", about="final distance only"),
    Measure("return_mean", "mean return", "return", "mean", format="number1"),
    Measure("return_std", "std of return", "return", "std", format="number1", detail=True),
    Measure("length_mean", "steps", "length", "mean", format="number1"),
    Measure("length_std", "std of steps", "length", "std", format="number1", detail=True),
    Measure("failure_distance_mean", "failure dist. [m]", "distance_m", "average", **_failed),
    Measure("failure_distance_std", "its std [m]", "distance_m", "std", **_failed, detail=True),
    Measure("failure_distance_max", "its max [m]", "distance_m", "max", **_failed, detail=True),
    Measure("distance_mean", "distance [m]", "distance_m", "average", **_metres, detail=True),
    Measure("angle_mean", "angle [deg]", "angle_deg", "average", format="number1", detail=True),
    Measure("choice_chance", "chance", "chance", "average"),
    Measure("choice_corrected", _CORRECTED, compute=_choice_corrected, detail=True),
    Measure("success_corrected", _CORRECTED, compute=_success_corrected, detail=True),
    Measure("chose_old_answer", "old answer", "chose_old_answer"),
    Measure("switched", "switched", compute=_switched, about="new of new and old answers"),
    Measure("saw_no_answer", "saw no answer", compute=_saw(lambda count: count == 0)),
    Measure("saw_several_answers", "saw several", compute=_saw(lambda count: count > 1)),
    Measure("coverage", "right one among the candidates", "covered"),
    Measure("questions", "asks", compute=_asks, about="not exactly one candidate"),
    Measure("difference", "agent minus this [points]", **_points),
    Measure(
        "vision_gain",
        "depends on vision [points]",
        about="success minus that of the better agent that sees nothing",
        detail=True,
        **_points,
    ),
    Measure(
        "binding",
        "follows its question [points]",
        about="right choices, minus those when told the question of another visible object",
        **_points,
    ),
)
MEASURES = {each.name: each for each in _ALL}
"""Measures of every evaluation, by name, in the order in which they are stored and shown."""
OF_QUERIES = ("episodes", "success", "choice")
"""Measures that are stored for every single query, of which there may be hundreds."""


def find_measure(name: str) -> Measure | None:
    """Return a measure of every evaluation or of a task by its name, or None."""
    if name in MEASURES:
        return MEASURES[name]
    return next((each for each in task_measures() if each.name == name), None)


def measure(name: str) -> Measure:
    """Return a measure by its name; one of a task that is not registered has no better title."""
    return find_measure(name) or Measure(name, name.replace("_", " "))


GROUPS = ("target", "facet", "query_type", "query")
"""Columns by whose values episodes are grouped, where they have them."""


def summarize(
    episodes: Columns, measures: Sequence[Measure] = ()
) -> tuple[Numbers, dict[str, dict[str, Numbers]]]:
    """Compute ``numbers`` and ``groups`` of a summary from the columns of the episodes.

    Args:
        episodes: the columns.
        measures: those of the task and of the probes.
    """
    wanted = [*_ALL, *measures]
    groups = {
        group: {
            str(value): _numbers(
                {name: each[episodes[group] == value] for name, each in episodes.items()},
                [m for m in wanted if group != "query" or m.name in OF_QUERIES],
            )
            for value in np.unique(episodes[group])
        }
        for group in GROUPS
        if group in episodes
    }
    return _numbers(episodes, wanted), groups


def _numbers(episodes: Columns, measures: Sequence[Measure]) -> Numbers:
    found = {each.name: _compute(each, episodes) for each in measures}
    return {
        name: each if isinstance(each, Interval) else float(each)
        for name, each in found.items()
        if each is not None
    }


def _compute(of: Measure, episodes: Columns) -> Number | None:
    """Return a measure of some episodes; None if they lack its column, or none counts."""
    if of.compute is not None:
        return of.compute(episodes)
    if (values := episodes.get(of.column)) is None:
        return None
    if of.equals is not None:
        values = values == of.equals
    if (among := of.among) is not None:
        values = values[episodes[among] if isinstance(among, str) else among(episodes)]
    return STATISTICS[of.statistic](values) if len(values) else None
