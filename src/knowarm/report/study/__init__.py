"""Run folders go in; tasks, agents and runs that may be compared come out."""

from knowarm.report.study.collect import collect
from knowarm.report.study.model import (
    Curve,
    Group,
    Judged,
    Problem,
    Reference,
    Run,
    Study,
    Task,
)

__all__ = [
    "Curve",
    "Group",
    "Judged",
    "Problem",
    "Reference",
    "Run",
    "Study",
    "Task",
    "collect",
]
