"""Summary of an evaluation: its settings and numbers, as stored, printed and reported."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from knowarm.config import check_values, from_dict
from knowarm.errors import UserError
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.experiment.measures import AGAIN, Numbers
from knowarm.reading import read_json, reading
from knowarm.statistics import Interval

FORMAT = 2
"""Version of the evaluation folder's layout."""
NEEDED = ("episodes", "success", "accuracy", "return_mean")
"""Measures without which there is no evaluation."""


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Settings and numbers of an evaluation: the content of ``summary.json``.

    ``summary["success"]`` is a number of all episodes.
    """

    format: int = FORMAT
    """Version of the layout."""
    agent: str
    """The agent, as ``experiment/seed``."""
    label: str
    """Name of the evaluation's folder."""
    config: EvaluationConfig
    """Episodes, thresholds and test conditions."""
    env: Mapping[str, Any]
    """Configuration of the environment that was played."""
    joints: tuple[str, ...] = ()
    """Names of the joints, in the order of their columns in ``steps.parquet``."""
    numbers: Numbers
    """Numbers of all episodes by the name of their measure."""
    groups: Mapping[str, Mapping[str, Numbers]]
    """Numbers of the episodes with each value of `GROUPS`; those of ``blind`` agents by name."""

    def __post_init__(self) -> None:
        check_values(self.numbers, where="numbers")
        check_values(self.groups, where="groups")
        if missing := [name for name in NEEDED if name not in self.numbers]:
            raise UserError(f"numbers of the summary {self.label} lack {', '.join(missing)}.")

    def __getitem__(self, name: str) -> float:
        """Return a number of all episodes, without its interval."""
        return self.interval(name).estimate

    def __contains__(self, name: str) -> bool:
        """Tell whether a number of all episodes is known."""
        return name in self.numbers

    def of(self, group: str = "", value: str = "") -> Numbers:
        """Return the numbers of all episodes, or of those with a value of `GROUPS`, if any."""
        return self.groups.get(group, {}).get(value, {}) if group else self.numbers

    def interval(self, name: str, group: str = "", value: str = "") -> Interval:
        """Return a number with its interval over episodes, of no width if it has none."""
        number = self.of(group, value)[name]
        return number if isinstance(number, Interval) else Interval(number, number, number)

    @classmethod
    def read(cls, folder: Path) -> "Summary":
        """Read the summary of an evaluation's folder."""
        path = folder / "summary.json"
        values = read_json(path, remedy=AGAIN)
        with reading(path, AGAIN):
            if values.get("format") != FORMAT:
                raise ValueError(f"format {values.get('format')!r}, this version reads {FORMAT}")
            return from_dict(cls, values)
