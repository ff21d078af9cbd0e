"""Splits of the choose task: which questions training asks, and which each test asks (`SPLITS`).

One training table serves all tests, so that one trained policy takes them all.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import suppress
from functools import cached_property
from itertools import compress, filterfalse
from typing import Literal, NamedTuple

import numpy as np

from knowarm.arrays import Mask
from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.queries.held_out import HeldOutQuestions, draw_edits
from knowarm.knowledge.queries.queries import Pairs, QueryGraph
from knowarm.questions import (
    ObjectColour,
    Query,
    QuestionTable,
    conditions_of,
    with_distractors,
)
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

TOPICS = {
    "S2": "queries",
    "S3": "objects",
    "S4": "values",
    "S5": "queries",
    "S3a": "instances",
    "S3b": "kinds",
}
"""What a test's episodes are about where training had none of it, by split: another draw of the
hold-outs would be one of other topics."""

DRAWN = {
    "S3": (3, HeldOutQuestions.hold_objects),
    "S3b": (6, HeldOutQuestions.hold_kinds),
    "S3a": (7, HeldOutQuestions.hold_instances),
    "S4": (4, HeldOutQuestions.hold_values),
    "S2": (2, HeldOutQuestions.hold_pairs),
}
"""Splits that hold something out of training, in the order of the draws: the number of the stream
that each draws from, and the draw."""

SEEDS = {"published": 0, "validation": 7_100_003, "test": 7_200_003}
"""Seeds of the declared draws; each leaves alone what those before it hold out or edit.

Networks and settings were chosen on the first one. Choices are to be made on the second, and nobody
looks at the third before they are made."""

NEW_OBJECTS = ("S3", "S3a", "S3b")
"""Those whose tests show objects that training never shows."""

HELD_OUT = ("S3", "S4", "S2")
"""Those of objects that belong to no family."""

NOT_NAMED = "hold_out does not name it."
_Rule = Callable[[Sequence[Query]], Mask]
"""Whether each query may be asked for each object, (Q, O)."""


def topic_of(split: str, query: str, target: str) -> str:
    """Return what an episode of a split is about, by its query and its object; see `TOPICS`."""
    topics = TOPICS.get(split, "queries")
    if topics in ("objects", "instances"):
        return target
    if topics == "kinds":
        kind, _, _ = target.rpartition("-")
        return kind
    if topics == "values":
        value, _, _ = query.partition(" and ")
        return value
    return query


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
    report: Callable[[str], object] = str,
) -> QuerySplits:
    """Draw what is held out, and make the table of training and those of the tests.

    Each split draws from its own stream of the seed; see `SEEDS` for declared ones. Only the splits
    in ``hold_out`` have a test. A question needs as many distractors as there are objects per
    episode, less one. ``edited`` is the graph of S5; None draws one by `draw_edits`. ``report``
    receives a line before each step.
    """
    for name in hold_out:
        if name not in DRAWN:
            raise unknown_name("split to hold out", name, DRAWN)
    asked = QueryGraph(graph, facets)
    report(f"Queries about {len(asked.objects):,} objects ...")
    maker = _Maker(asked, pairs, objects)
    for declared in _before(seed):
        _hold_out(maker.held, declared, hold_out, objects)
        with suppress(UserError):
            _draw_edits(maker.held, declared)
        maker.draw_again()
    held = maker.held
    failed = _hold_out(held, seed, hold_out, objects, report)
    drawn = [name for name in hold_out if name not in failed]
    reasons = dict.fromkeys(HELD_OUT, NOT_NAMED) | failed
    report(f"Questions of training, out of {len(maker.queries):,} queries ...")
    train = maker.table(held.in_training)
    if train is None:
        raise UserError(
            f"Training would ask nothing: no query singles out one of {objects} objects of which "
            "each distractor shares a fact or colour with it. Give more objects or facts, fewer "
            "objects per episode, or hold out less."
        )
    tables: dict[str, QuestionTable | None] = {"S1": train}
    rules = {"S2": held.is_new_pair, **dict.fromkeys(NEW_OBJECTS, held.is_new_object)}
    rules["S4"] = held.is_new_value
    for name, rule in rules.items():
        if name in drawn:
            report(f"Questions of {name} ...")
            tables[name] = maker.table(rule, show=held.new.get(name))
    report("Questions of S5 ...")
    try:
        if edited is None:
            edited = _draw_edits(held, seed)
        tables["S5"] = maker.edited_table(edited)
    except UserError as error:
        reasons["S5"] = str(error)
    tests = {}
    for name, table in tables.items():
        if table is not None:
            tests[name] = table
            reasons.pop(name, None)
            continue
        reasons[name] = (
            f"no question of it has {objects - 1} distractors that share something with the "
            "target. Give more objects or facts, or fewer objects per episode."
        )
    report("")
    reasons = {name: reasons[name] for name in SPLITS if name in reasons}
    return QuerySplits(train, tests, reasons, held, edited)


def _before(seed: int) -> list[int]:
    """Return the declared seeds whose draws a seed leaves alone."""
    seeds = list(SEEDS.values())
    return seeds[: seeds.index(seed)] if seed in seeds else []


def _hold_out(
    held: HeldOutQuestions,
    seed: int,
    splits: Collection[str],
    objects: int,
    report: Callable[[str], object] = str,
) -> dict[str, str]:
    """Draw what each split holds out; return why some of them hold out nothing."""
    failed = {}
    for name, (number, hold) in DRAWN.items():
        if name not in splits:
            continue
        report(f"What {name} holds out ...")
        rng = np.random.default_rng(seed_sequence(seed, "splits", number))
        try:
            hold(held, rng, objects)
        except UserError as error:
            failed[name] = str(error)
    return failed


def _draw_edits(held: HeldOutQuestions, seed: int) -> KnowledgeGraph:
    """Draw the edits of S5 from the stream of a seed."""
    return draw_edits(held, np.random.default_rng(seed_sequence(seed, "splits", 5)))


class _Maker:
    """Makes tables from rules about queries and objects."""

    def __init__(self, asked: QueryGraph, pairs: Pairs, objects: int) -> None:
        self.asked = asked
        self.pairs = pairs
        self.objects = objects
        self.queries = asked.queries(pairs)
        self.satisfies = asked.answers(self.queries)
        holders = {}
        for query, row in zip(self.queries, self.satisfies, strict=True):
            if len(query.conditions) == 1:
                names = {asked.objects[number] for number in asked.owner[row]}
                holders[query.conditions[0]] = sorted(names)
        self.held = HeldOutQuestions(asked, holders)

    def draw_again(self) -> None:
        """Begin a draw that leaves alone what was drawn so far."""
        earlier = (*self.held.earlier, self.held)
        self.held = HeldOutQuestions(self.asked, self.held.holders, earlier=earlier)

    @cached_property
    def related(self) -> Mask:
        """Whether two facets share a condition, (F, F)."""
        return _related(self.satisfies[: len(self.held.holders)])

    def table(
        self, rule: _Rule, *, show: Collection[str] | None = None
    ) -> QuestionTable | None:
        """Return the table of the questions that a rule about queries and objects allows, if any.

        A facet is shown only if some question has it as its target, so that what is seen does not
        tell what is asked. ``show`` names the objects that may be seen; None: those of training.
        """
        satisfies = self.satisfies
        shown = self.asked.possible()
        if show is None:
            show = set(self.asked.objects) - self.held.objects
        shown &= self._of(show)
        related = self.related
        owner = self.asked.owner
        allowed = satisfies & rule(self.queries)[:, owner]
        while True:
            askable = with_distractors(
                allowed & shown, satisfies, related, shown, owner, self.objects
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
        conditions = set(conditions_of(self.queries))
        queries = list(self.queries)
        queries += filterfalse(
            lambda query: conditions.issuperset(query.conditions),
            other.queries(self.pairs),
        )
        satisfies = other.answers(queries)
        before = self.asked.answers(queries)
        shown = other.possible() & ~self._of(self.held.objects)
        owner = self.asked.owner
        in_training = self.held.in_training(queries)[:, owner]
        new = satisfies & ~before & in_training & shown
        if not new.any():
            raise UserError(
                "the edited graph gives no query of training another answer. Change triples "
                "about objects of the task, such as (mug, usedFor, repairing)."
            )
        single = np.array([len(query.conditions) == 1 for query in queries])
        related = _related(np.concatenate([satisfies[single], before[single]]))
        askable = with_distractors(new, satisfies, related, shown, owner, self.objects)
        kept = np.any(satisfies, axis=1)
        kept_queries = list(compress(queries, kept))
        return self._table(kept_queries, satisfies[kept], askable[kept], related, shown)

    def _of(self, names: Collection[str]) -> Mask:
        """Return which facets are those of some objects, (F,) bool."""
        return np.isin(self.asked.objects, list(names))[self.asked.owner]

    def _table(
        self,
        queries: Sequence[Query],
        satisfies: Mask,
        askable: Mask,
        related: Mask,
        shown: Mask,
    ) -> QuestionTable | None:
        if not askable.any():
            return None
        return QuestionTable(
            tuple(queries), self.asked.facets, satisfies, askable, related, shown
        )


def _related(conditions: Mask) -> Mask:
    """Return which facets share one of the conditions (C, F): (F, F) bool."""
    packed = np.packbits(conditions, axis=0)
    _, first, kind = np.unique(packed, axis=1, return_index=True, return_inverse=True)
    shares = conditions[:, first].astype(np.float32)
    return np.asarray(shares.T @ shares > 0)[kind][:, kind]
