"""Choice table: which queries an episode may ask, and which facets answer them."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError

Facet = tuple[str, str]
"""An object and one of its colours, by name."""


@dataclass(frozen=True, eq=False)
class ChoiceTable:
    """Queries and facets of a choice task: all that the world needs to know about knowledge.

    Several tables share their queries and facets, and so the rows of a policy's knowledge table,
    and differ in what they ask and show: those are the splits of a study.

    Raises:
        UserError: sizes or names that do not fit, a query that no facet satisfies, a question
            whose target is not shown or for which no distractor exists, or no question at all.
    """

    queries: tuple[str, ...]
    """Readable queries such as "usedFor drinking", Q."""

    facets: tuple[Facet, ...]
    """(object, colour) pairs, F."""

    satisfies: NDArray[np.bool_] = field(repr=False)
    """Whether a facet answers a query, (Q, F)."""

    askable: NDArray[np.bool_] = field(repr=False)
    """Whether an episode may ask a query for a facet as its target, (Q, F)."""

    related: NDArray[np.bool_] = field(repr=False)
    """Whether two facets share something, (F, F), symmetric; a distractor shares something with
    the target. The diagonal is not read."""

    shown: NDArray[np.bool_] = field(repr=False)
    """Whether a facet may stand in the rectangle, (F,)."""

    def __post_init__(self) -> None:
        queries, facets = len(self.queries), len(self.facets)
        for kind, names in (("queries", self.queries), ("facets", self.facets)):
            if not names:
                raise UserError(f"ChoiceTable.{kind} is empty; give at least one.")
            twice = [name for name in names if names.count(name) > 1]
            if twice:
                raise UserError(f"ChoiceTable.{kind} contains {twice[0]!r} twice; list each once.")
        for name, shape in (
            ("satisfies", (queries, facets)),
            ("askable", (queries, facets)),
            ("related", (facets, facets)),
            ("shown", (facets,)),
        ):
            array = getattr(self, name)
            if array.shape != shape or array.dtype != np.bool_:
                raise UserError(
                    f"ChoiceTable.{name} must be a bool array of shape {shape} for {queries} "
                    f"queries and {facets} facets, got {array.dtype} of shape {array.shape}."
                )
        if (self.related != self.related.T).any():
            a, b = np.argwhere(self.related != self.related.T)[0]
            raise UserError(
                f"ChoiceTable.related must be symmetric: {_words(self.facets[a])} and "
                f"{_words(self.facets[b])} are related in one direction only."
            )
        self._check_questions()

    @property
    def objects(self) -> NDArray[np.int64]:
        """Number of each facet's object, in order of first appearance, (F,)."""
        names = list(dict.fromkeys(name for name, _ in self.facets))
        return np.array([names.index(name) for name, _ in self.facets], dtype=np.int64)

    def distractors(self, query: int) -> NDArray[np.bool_]:
        """Return the facets that may stand beside each target of a query, (F, F) bool.

        They are shown, related to the target, of another object, and do not satisfy the query.
        """
        objects = self.objects
        other = objects[:, None] != objects
        return np.asarray(self.shown & ~self.satisfies[query] & self.related & other)

    def check_objects(self, count: int) -> None:
        """Check that every question has enough distractors for ``count`` objects per episode.

        Raises:
            UserError: a question has too few; the message names it.
        """
        objects = self.objects
        owner = objects[:, None] == np.arange(objects.max() + 1)
        for query in map(int, np.flatnonzero(self.askable.any(axis=1))):
            beside = self.distractors(query)
            found = (beside.astype(np.int64) @ owner) > 0
            few = np.flatnonzero(self.askable[query] & (found.sum(axis=1) < count - 1))
            if len(few):
                target = few[0]
                names = sorted({self.facets[f][0] for f in np.flatnonzero(beside[target])})
                raise UserError(
                    f"Query {self.queries[query]!r} with target {_words(self.facets[target])} has "
                    f"distractors of {len(names)} objects ({', '.join(names) or 'none'}) that "
                    "share something with the target and do not satisfy the query; "
                    f"{count} objects per episode need {count - 1}. Show more facets, relate "
                    "more of them, do not ask this query for this facet, or use fewer objects."
                )

    def _check_questions(self) -> None:
        """Check queries, targets and distractors."""
        for query in np.flatnonzero(~self.satisfies.any(axis=1)):
            raise UserError(
                f"No facet satisfies the query {self.queries[query]!r}: add a triple that makes "
                "one satisfy it, or remove the query."
            )
        for query, target in np.argwhere(self.askable & ~self.satisfies):
            raise UserError(
                f"The query {self.queries[query]!r} may be asked for "
                f"{_words(self.facets[target])}, which does not satisfy it; clear that entry of "
                "askable, or set the one of satisfies."
            )
        for query, target in np.argwhere(self.askable & ~self.shown):
            raise UserError(
                f"The query {self.queries[query]!r} may be asked for "
                f"{_words(self.facets[target])}, which this split does not show; show the facet, "
                "or clear that entry of askable."
            )
        if not self.askable.any():
            raise UserError(
                f"The split is empty: none of the {len(self.queries)} queries may be asked for "
                f"any of the {int(self.shown.sum())} facets that are shown. Hold out less, or "
                "give more objects or queries."
            )
        self.check_objects(2)


def _words(facet: Facet) -> str:
    name, colour = facet
    return f"{colour} {name}"
