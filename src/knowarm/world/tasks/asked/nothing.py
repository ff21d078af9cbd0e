"""Nothing is asked: one object is visible (paper, section 3)."""

from dataclasses import dataclass
from typing import Literal

from knowarm.world.tasks.asked.asked import Asking


@dataclass(frozen=True, kw_only=True)
class AskNothing(Asking):
    """One object is visible, and it is the one that is meant."""

    kind: Literal["nothing"] = "nothing"
    """Tag in JSON."""

    @property
    def title(self) -> str:
        """No words: nothing is asked."""
        return ""
