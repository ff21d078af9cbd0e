"""Splits of the choose task: which questions training asks, and which each test asks (`SPLITS`).

One training table serves all tests, so that one trained policy takes them all.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Literal, NamedTuple

import numpy as np

from knowarm.arrays import Mask
from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.queries.held_out import HeldOutQuestions, draw_edits
from knowarm.knowledge.queries.queries import Pairs, QueryGraph
from knowarm.questions import ObjectColour, Query, QuestionTable, with_distractors
from knowarm.seeding import seed_sequence

Split = Literal["train", "S1", "S2", "S3", "S4", "S5", "S3a", "S3b"]
SPLITS = {
    "S1": "new layouts",
    "S2": "pairs of condition and object that training never asked",
    "S3": "objects that training never showed",
    "S4": "values that training never asked, linked to ones that it did",
    "S5": "answers that changed with the graph",
    "S3a": "new instances of kinds that training showed",
    "S3b": "instances of kinds that training never showed",
}
"""Every split by name, and what its test asks."""

DRAWN = {
    "S3": (3, HeldOutQuestions.hold_objects),
    "S3b": (6, HeldOutQuestions.hold_kinds),
    "S3a": (7, HeldOutQuestions.hold_instances),
    "S4": (4, HeldOutQuestions.hold_values),
    "S2": (2, HeldOutQuestions.hold_pairs),
}
"""Splits that hold something out of training, in the order of the draws: the number of the stream
that each draws from, and the draw."""

NEW_OBJECTS = ("S3", "S3a", "S3b")
"""Those whose tests show objects that training never shows."""

HELD_OUT = ("S3", "S4", "S2")
"""Those of objects that belong to no family."""

NOT_NAMED = "hold_out does not name it."


class QuerySplits(NamedTuple):
    """The tables of a choose task and what was held out."""

    train: QuestionTable
    tests: dict[str, QuestionTable]  # Questions of each test, by the split's name
    reasons: dict[str, str]  # Why a test is missing, by the split's name
    held_out: HeldOutQuestions
    edited: KnowledgeGraph | None  # The graph of S5

    def test(self, name: str) -> QuestionTable:
        """Return the table of a split's test."""
        if name not in SPLITS:
            raise unknown_name("split", name, SPLITS)
        if name not in self.tests:
            reason = self.reasons.get(name, NOT_NAMED)
            raise UserError(f"The split {name} ({SPLITS[name]}) is empty: {reason}")
        return self.tests[name]


def query_splits(
    graph: KnowledgeGraph,
    facets: Iterable[ObjectColour],
    *,
    seed: int = 0,
    pairs: Pairs = "colour",
    objects: int = 4,
    hold_out: Collection[str] = HELD_OUT,
    edited: KnowledgeGraph | None = None,
) -> QuerySplits:
    """Draw what is held out, and make the table of training and those of the tests.

    Each split draws from its own stream of the seed. Only the splits in ``hold_out`` have a test. A
    question needs as many distractors as there are objects per episode, less one. ``edited`` is the
    graph of S5; None draws one by `draw_edits`.
    """
    for name in hold_out:
        if name not in DRAWN:
            raise unknown_name("split to hold out", name, DRAWN)
    asked = QueryGraph(graph, facets)
    maker = _Maker(asked, pairs, objects)
    held = maker.held
    reasons = dict.fromkeys(HELD_OUT, NOT_NAMED)
    for name, (number, hold) in DRAWN.items():
        rng = np.random.default_rng(seed_sequence(seed, "splits", number))
        try:
            if name in hold_out:
                hold(held, rng, objects)
        except UserError as error:
            reasons[name] = str(error)
    train = maker.table(held.in_training)
    if train is None:
        raise UserError(
            f"Training would ask nothing: no query singles out one of {objects} objects of which "
            "each distractor shares a fact or colour with it. Give more objects or facts, fewer "
            "objects per episode, or hold out less."
        )
    tables: dict[str, QuestionTable | None] = {"S1": train}
    if held.pairs:
        tables["S2"] = maker.table(held.is_new_pair)
    for name in filter(held.new.__contains__, NEW_OBJECTS):
        tables[name] = maker.table(held.is_new_object, show=held.new[name])
    if held.values:
        tables["S4"] = maker.table(held.is_new_value)
    try:
        if edited is None:
            edited = draw_edits(held, np.random.default_rng(seed_sequence(seed, "splits", 5)))
        tables["S5"] = maker.edited_table(edited)
    except UserError as error:
        reasons["S5"] = str(error)
    tests = {name: table for name, table in tables.items() if table is not None}
    no_distractors = (
        f"no question of it has {objects - 1} distractors that share something with the "
        "target. Give more objects or facts, or fewer objects per episode."
    )
    reasons |= dict.fromkeys(tables.keys() - tests.keys(), no_distractors)
    reasons = {name: reasons[name] for name in SPLITS if name in reasons and name not in tests}
    return QuerySplits(train=train, tests=tests, reasons=reasons, held_out=held, edited=edited)


class _Maker:
    """Makes tables from rules about (query, object)."""

    def __init__(self, asked: QueryGraph, pairs: Pairs, objects: int) -> None:
        self.asked, self.pairs, self.objects, self.owner = asked, pairs, objects, asked.owner
        self.queries = asked.queries(pairs)
        self.satisfies = asked.answers(self.queries)
        single = [q.conditions[0] for q in self.queries if len(q.conditions) == 1]
        holders = {
            condition: sorted({asked.objects[i] for i in self.owner[row]})
            for condition, row in zip(single, list(self.satisfies), strict=False)
        }
        self.held = HeldOutQuestions(asked, holders)

    def table(
        self, rule: Callable[[Query, str], bool], *, show: Collection[str] | None = None
    ) -> QuestionTable | None:
        """Return the table of the questions that a rule about (query, object) allows, if any.

        A facet is shown only if some question has it as its target, so that what is seen does not
        tell what is asked. ``show`` names the objects that may be seen; None: those of training.
        """
        satisfies = self.satisfies
        held = np.isin(self.owner, self._numbers(self.held.objects if show is None else show))
        shown = self.asked.possible() & (~held if show is None else held)
        related = _related(satisfies[: len(self.held.holders)])
        allowed = satisfies & self._allowed(self.queries, rule)
        while True:
            askable = with_distractors(
                allowed & shown, satisfies, related, shown, self.owner, self.objects
            )
            targets = shown & askable.any(0)
            if (targets == shown).all():
                return self._table(self.queries, satisfies, askable, related, shown)
            shown = targets

    def edited_table(self, edited: KnowledgeGraph) -> QuestionTable | None:
        """Return the table of S5: questions of training that the edited graph answers otherwise.

        Facets that shared something before the edit still count as related, so that the old
        answer may stand beside the new one.
        """
        other = QueryGraph(edited, self.asked.facets)
        conditions = {condition for query in self.queries for condition in query.conditions}
        added = [q for q in other.queries(self.pairs) if not conditions.issuperset(q.conditions)]
        queries = [*self.queries, *added]
        satisfies, before = other.answers(queries), self.asked.answers(queries)
        shown = other.possible() & ~np.isin(self.owner, self._numbers(self.held.objects))
        new = satisfies & ~before & self._allowed(queries, self.held.in_training) & shown
        if not new.any():
            raise UserError(
                "the edited graph gives no query of training another answer. Change triples "
                "about objects of the task, such as (mug, usedFor, repairing)."
            )
        single = np.array([len(query.conditions) == 1 for query in queries])
        related = _related(np.concatenate([satisfies[single], before[single]]))
        askable = with_distractors(new, satisfies, related, shown, self.owner, self.objects)
        kept = np.asarray(satisfies.any(1))
        kept_queries = [query for query, keep in zip(queries, kept, strict=True) if keep]
        return self._table(kept_queries, satisfies[kept], askable[kept], related, shown)

    def _numbers(self, names: Collection[str]) -> list[int]:
        return [self.asked.objects.index(name) for name in names]

    def _allowed(self, queries: Sequence[Query], rule: Callable[[Query, str], bool]) -> Mask:
        """Return a rule about (query, object) for each query and facet, (Q, F) bool."""
        by_object = np.array([[rule(q, name) for name in self.asked.objects] for q in queries])
        return np.asarray(by_object[:, self.owner])

    def _table(
        self, queries: Sequence[Query], satisfies: Mask, askable: Mask, related: Mask, shown: Mask
    ) -> QuestionTable | None:
        if not askable.any():
            return None
        facets = self.asked.facets
        return QuestionTable(tuple(queries), facets, satisfies, askable, related, shown)


def _related(conditions: Mask) -> Mask:
    """Return which facets share one of the conditions (C, F): (F, F) bool."""
    shares = conditions.astype(np.float32)
    return np.asarray(shares.T @ shares > 0)
