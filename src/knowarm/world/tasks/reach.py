"""Reaching task (paper, section 3)."""

from dataclasses import dataclass
from typing import Literal

from knowarm.world.tasks.task import Task


@dataclass(frozen=True, kw_only=True)
class Reach(Task):
    """Reach the grasp frame of the one visible object (paper, section 3)."""

    kind: Literal["reach"] = "reach"
    """Tag of this task in JSON."""

    @property
    def title(self) -> str:
        """No words: this is the paper's task."""
        return ""
