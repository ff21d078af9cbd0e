"""Probes: what is recorded or measured of episodes that were played, besides their outcome."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from knowarm.arrays import Floats, Indices, Mask
from knowarm.measures import Measure
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.sampling import Episodes


class ReportTable(NamedTuple):
    """A table of the report: one row per agent and conditions of the episodes."""

    name: str
    """Of its CSV file."""
    title: str
    """Heading."""
    measures: tuple[str, ...]
    """Names of the measures that are columns; the first decides whether an evaluation has a row."""
    note: str
    """What the columns mean."""


class PlayedEpisodes(Protocol):
    """n episodes that an agent played, and their outcome."""

    episodes: Episodes

    @property
    def scene(self) -> Scene:
        """Robot and objects."""

    @property
    def success(self) -> Mask:
        """Which episodes were solved, (n,)."""

    def paths(self, rows: Indices) -> Sequence[Floats]:
        """Return the joint angles of some episodes by step, (T, J) [rad] each."""


@dataclass
class Findings:
    """What probes found: columns of episodes and steps, numbers, and groups of numbers."""

    columns: dict[str, np.ndarray]
    steps: dict[str, np.ndarray] | None = None
    numbers: dict[str, Any] = field(default_factory=dict)
    groups: dict[str, Mapping[str, dict[str, Any]]] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class BaseProbe:
    """Something recorded or measured of the episodes.

    One that a skill or what is asked names among its ``probes`` is an option of its ``kind``.
    """

    label: ClassVar[str] = ""
    """Its part of the name of the evaluation's folder."""
    about: ClassVar[str] = ""
    """Help of its option."""
    measures: ClassVar[tuple[Measure, ...]] = ()
    """Numbers of an evaluation, computed from the columns that it adds."""
    column_meanings: ClassVar[dict[str, str]] = {}
    """What each of these columns holds."""
    table: ClassVar[ReportTable | None] = None
    """The report's table of these numbers."""
    kind: str = ""
    """Tag in JSON, a literal of each probe."""

    def check(self, scene: Scene, task: str) -> None:
        """Refuse, before anything is played, the scene of a task in which it cannot measure.

        Raises:
            UserError: it cannot.
        """

    def measure(self, played: Any, findings: Findings) -> None:
        """Add what it measures of `PlayedEpisodes` to what was found."""
