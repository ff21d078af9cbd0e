"""Measures: numbers of a group of episodes, each named, described and defined once."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

Columns = Mapping[str, np.ndarray]
"""One (n,) array per column of ``episodes.parquet``."""


@dataclass(frozen=True)
class Measure:
    """A number of a group of episodes; tasks and evaluations have some."""

    name: str
    """Its key in ``summary.json``, in tables and in CSV files."""
    title: str
    """Heading, with the unit."""
    column: str = ""
    """Column of the episodes that it is computed from; without it they lack the measure."""
    statistic: Literal["share", "mean", "average", "std", "max", "count"] = "share"
    """What it is of the column's values; a "share" and a "mean" have a 95 % interval."""
    equals: str | int | None = None
    """Value of the column that is counted, in place of true."""
    among: str | Callable[[Columns], np.ndarray] | None = None
    """Bool column of the episodes that count, or a function that computes it; None: all do."""
    compute: Callable[[Columns], Any] | None = None
    """In place of the statistic: a number or interval of all columns, or None."""
    format: str = "percent"
    """How it is shown, a key of `knowarm.report.format.FORMATS`."""
    detail: bool = False
    """Whether tables in the terminal leave it out."""
    about: str = ""
    """Explanation of the heading."""
