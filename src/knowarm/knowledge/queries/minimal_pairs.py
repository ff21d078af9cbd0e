"""Minimal pairs: edits of one fact that change what answers a query, and edits that do not."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, product
from typing import Literal, NamedTuple

import numpy as np
from numpy.random import Generator

from knowarm.knowledge.graph.builder import with_triples
from knowarm.knowledge.graph.graph import KnowledgeGraph, Triple
from knowarm.knowledge.graph.terms import local_name
from knowarm.knowledge.queries.queries import QueryGraph
from knowarm.questions import Condition, ObjectColour, Query

EditKind = Literal["deciding", "placebo", "removal"]
"""What an edit does: another visible object answers; the answer stays; no visible one answers."""
SHOWN = ("hasShape", "hasPart", "isConnectedTo", "hasSize")
"""Relations whose facts an image shows, as it shows colours; others have to be known."""


class Edit(NamedTuple):
    """A triple that a graph states, and what stands in its place."""

    old: Triple
    new: Triple | None  # None removes it

    def apply(self, graph: KnowledgeGraph) -> KnowledgeGraph:
        """Return the edited graph."""
        triples = list(filter(self.old.__ne__, graph.stated()))
        if self.new is not None:
            triples.append(self.new)
        return with_triples(graph, triples)


class MinimalPair(NamedTuple):
    """Edits of a graph for one question."""

    fact: Triple  # By which the right object answers
    heir: int  # Number of the visible facet that answers after the deciding edit
    edits: dict[EditKind, Edit]

    @property
    def is_shown(self) -> bool:
        """Whether an image shows the fact."""
        return local_name(self.fact[1]) in SHOWN


@dataclass(frozen=True)
class Question:
    """A question of an episode, which a graph answers.

    Attributes:
        facets: the visible ones, that which answers first.
        others: objects that are not visible.
    """

    graph: KnowledgeGraph
    query: Query
    facets: Sequence[ObjectColour]
    others: Sequence[str]

    def minimal_pair(self, rng: Generator) -> MinimalPair | None:
        """Find the edits, drawn among equals; None if one of them cannot be made.

        The deciding edit gives the fact to another visible object. The placebo moves a triple of
        the same relation and value between objects that are not visible: of these it takes those
        whose numbers of triples are most like those of the objects of the deciding edit. What every
        edit does to the answers is computed.
        """
        facts = [part for part in self.query.conditions if not part.is_seen]
        return next(chain.from_iterable(self._pairs(fact, rng) for fact in facts), None)

    def answering(self, edit: Edit) -> list[int]:
        """Return the numbers of the visible facets that answer after an edit."""
        asked = QueryGraph(edit.apply(self.graph), self.facets)
        return np.flatnonzero(asked.answers([self.query])[0]).tolist()

    def _pairs(self, condition: Condition, rng: Generator) -> Iterator[MinimalPair]:
        """Yield the edits of the fact that satisfies a condition."""
        names = self.graph.names
        visible = [names[self.graph.entity_id(name)] for name, _ in self.facets]
        relation = self.graph.relation_names[self.graph.relation_id(condition.relation)]
        value = names[self.graph.entity_id(condition.value)]
        fact = (visible[0], relation, value)
        stated = set(self.graph.stated())
        removal = Edit(fact, None)
        if fact not in stated or self.answering(removal):
            return  # it follows from others, or does not decide
        for heir in rng.permutation(np.arange(1, len(visible))).tolist():
            deciding = Edit(fact, (visible[heir], relation, value))
            if self.answering(deciding) != [heir]:
                continue
            for old, new in self._alike(visible[0], visible[heir], rng):
                placebo = Edit((old, relation, value), (new, relation, value))
                may_move = placebo.old in stated and placebo.new not in stated
                if may_move and self.answering(placebo) == [0]:
                    edits: dict[EditKind, Edit] = {
                        "deciding": deciding,
                        "placebo": placebo,
                        "removal": removal,
                    }
                    yield MinimalPair(fact, heir, edits)
                    return

    def _alike(self, old: str, new: str, rng: Generator) -> Iterator[tuple[str, str]]:
        """Yield pairs of objects that are not visible, those with as many triples first."""
        graph = self.graph
        ends = np.concatenate([graph.heads, graph.tails])
        degrees = Counter(graph.names.at(ends))
        known = map(graph.find_entity, self.others)
        names = [graph.names[entity] for entity in known if entity is not None]
        pairs = list(product(names, repeat=2))
        unlike = [
            abs(degrees[first] - degrees[old]) + abs(degrees[second] - degrees[new])
            for first, second in pairs
        ]
        for number in np.lexsort((rng.random(len(pairs)), np.array(unlike))):
            yield pairs[number]
