"""Part of a task: what the things that can be asked and the skills have in common."""

from dataclasses import dataclass
from typing import ClassVar

from knowarm.measures import Measure
from knowarm.world.tasks.probe import BaseProbe, ReportTable
from knowarm.world.tasks.registry import kind_of
from knowarm.world.tasks.sampling import Setting
from knowarm.world.tasks.state import NamedArrays


@dataclass(frozen=True, kw_only=True)
class BaseTaskPart:
    """Base of `Asking` and `Skill`: a name, and what is recorded and reported."""

    column_meanings: ClassVar[dict[str, str]] = {}
    """What each of the ``columns`` holds."""
    measures: ClassVar[tuple[Measure, ...]] = ()
    """Further numbers of an evaluation, computed from ``columns`` and those of every evaluation."""
    probes: ClassVar[tuple[type[BaseProbe], ...]] = ()
    """What it brings to measure in evaluations of any task, as options of theirs."""
    tables: ClassVar[tuple[ReportTable, ...]] = ()
    """Tables of the report of its ``measures``."""
    kind: str = ""
    """Tag in JSON and in the names of experiments, a literal of each class."""

    @property
    def title(self) -> str:
        """Words in the titles of a report; none for the paper's task."""
        return kind_of(type(self))

    def columns(self, setting: Setting, infos: NamedArrays) -> NamedArrays:
        """Return further columns of an evaluation's ``episodes.parquet``, (N,) each.

        Args:
            setting: what the episodes were drawn from.
            infos: the infos at the end of N episodes.
        """
        return {}
