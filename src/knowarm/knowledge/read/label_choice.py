"""The label statements of a file go in; one label an entity comes out."""

from knowarm.knowledge.term import is_literal, literal_parts

LABEL_RELATIONS = (
    "http://www.w3.org/2000/01/rdf-schema#label",
    "http://www.w3.org/2004/02/skos/core#prefLabel",
)


class LabelChoice:
    """Keeps the best label of each entity: English, then no language, then any; then by letter.

    Attributes:
        best: (rank of the language, text) by name; the smallest stands.
    """

    def __init__(self) -> None:
        self.best: dict[str, tuple[int, str]] = {}

    def take(self, head: str, relation: str, tail: str) -> bool:
        """Take a triple if it is a label statement; return whether it was one."""
        if relation not in LABEL_RELATIONS or not is_literal(tail):
            return False
        text, language, _ = literal_parts(tail)
        rank = 0 if (language or "").startswith("en") else 1 if language is None else 2
        candidate = (rank, text)
        if head not in self.best or candidate < self.best[head]:
            self.best[head] = candidate
        return True

    def chosen(self) -> dict[str, str]:
        """Return the label by name."""
        return {name: text for name, (_, text) in self.best.items()}
