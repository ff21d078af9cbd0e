"""What was looked up, label by label, goes in; a report of what was found comes out."""

from dataclasses import dataclass, field
from typing import Any


@dataclass
class Coverage:
    """How the labels of a scene were found in a vocabulary.

    Attributes:
        how: by label: "word", "joined", "words", "form", "alias", "part" (some words only),
            "hash", "missing", or "entity" for graph embeddings.
        missing: words that were not found in any form.
    """

    how: dict[str, str] = field(default_factory=dict)
    missing: set[str] = field(default_factory=set)

    @property
    def share(self) -> float:
        """Share of the labels of which all words were found, 0 to 1."""
        if not self.how:
            return 1.0
        lost = sum(kind in ("part", "hash", "missing") for kind in self.how.values())
        return 1.0 - lost / len(self.how)

    def describe(self) -> dict[str, Any]:
        """Return the report as JSON-able values."""
        kinds = sorted(set(self.how.values()))
        return {
            "share": self.share,
            "labels": len(self.how),
            "by_kind": {kind: sum(k == kind for k in self.how.values()) for kind in kinds},
            "not_whole": sorted(
                label for label, kind in self.how.items() if kind in ("part", "hash", "missing")
            ),
            "missing_words": sorted(self.missing),
        }
