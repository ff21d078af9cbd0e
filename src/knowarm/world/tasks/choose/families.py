"""Families task: choosing among objects of which each kind has many instances."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from knowarm.world.objects.families import FAMILIES
from knowarm.world.tasks.choose.choose import Choose


@dataclass(frozen=True, kw_only=True)
class Families(Choose):
    """Instances of families, of which exactly one answers the episode's question."""

    targets: ClassVar[tuple[str, ...]] = FAMILIES

    kind: Literal["families"] = "families"  # type: ignore[assignment]
    """Tag of this task in JSON."""
