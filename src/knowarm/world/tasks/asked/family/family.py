"""Asking for an instance of a family, of which instances differ in shape and parts."""

from dataclasses import dataclass, field
from functools import partial
from typing import Literal

from knowarm.world.tasks.asked.family.families import FAMILIES
from knowarm.world.tasks.asked.query.query import AskObject
from knowarm.world.tasks.asked.query.query_source import GraphQueries, NameQueries


@dataclass(frozen=True, kw_only=True)
class AskInstance(AskObject):
    """Instances of families, of which exactly one answers the episode's question."""

    targets = FAMILIES

    kind: Literal["families"] = "families"  # type: ignore[assignment]
    """Tag in JSON."""
    queries: GraphQueries | NameQueries = field(
        default_factory=partial(
            GraphQueries, graph="families", hold_out=("S3b", "S3a", "S4", "S2")
        )
    )
    """Where the questions come from, and which objects answer them."""
