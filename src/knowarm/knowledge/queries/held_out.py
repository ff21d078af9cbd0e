"""Held-out objects, values and pairs of the choose task, and edits of its graph.

Every draw keeps what training needs: conditions with objects that answer them, and objects with
facts to be asked by.
"""

from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations, filterfalse
from operator import attrgetter

import numpy as np
from numpy.random import Generator

from knowarm.arrays import Mask
from knowarm.errors import UserError
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import local_name
from knowarm.knowledge.queries.queries import QueryGraph
from knowarm.questions import OBJECT_RELATION, Condition, Query, kind_of

SHARES = {"S2": 0.2, "S3": 0.23, "S3a": 0.25, "S3b": 0.25, "S4": 0.15, "S5": 0.2}
"""Share that a split holds out or changes: of the objects of each condition (S2), of the objects
(S3), of the instances of each kind (S3a), of the kinds (S3b), of the values (S4), of the conditions
that are not colours (S5)."""
_Names = set[str]
"""Names of objects, of kinds of these, or of values."""


@dataclass
class HeldOutQuestions:
    """What training leaves out; each draw adds to it."""

    asked: QueryGraph
    holders: Mapping[Condition, list[str]]  # Objects that satisfy each condition
    # Objects that training never shows, by the split that tests them (S3, S3a, S3b)
    new: dict[str, _Names] = field(default_factory=dict)
    objects: _Names = field(default_factory=set)  # All of these
    # Values that training never asks (S4)
    values: _Names = field(default_factory=set)
    # Conditions and objects that training never asks together (S2)
    pairs: set[tuple[Condition, str]] = field(default_factory=set)
    # Conditions whose objects an edit changed (S5)
    swapped: set[Condition] = field(default_factory=set)
    # Draws whose held-out objects, kinds, values, pairs and edits this one leaves alone
    earlier: tuple["HeldOutQuestions", ...] = ()

    @property
    def facts(self) -> list[Condition]:
        """The conditions that the graph answers."""
        return [condition for condition in self.holders if not condition.is_seen]

    def hold_objects(self, rng: Generator, per_episode: int) -> None:
        """Hold out objects; each condition keeps half of its objects or more (S3)."""
        names = sorted(self.asked.objects)
        wanted = max(per_episode + 1, round(SHARES["S3"] * len(names)))
        held = self._some(rng, names, wanted, per_episode, self._new_before("S3"))
        self._hold("S3", held)

    def hold_kinds(self, rng: Generator, per_episode: int) -> None:
        """Hold out all instances of some kinds; each condition keeps half of its kinds (S3b)."""
        kinds = set(map(kind_of, self._instances()))
        wanted = max(2, round(SHARES["S3b"] * len(kinds)))
        spared = set(map(kind_of, self._new_before("S3b")))
        held = self._some(rng, sorted(kinds), wanted, per_episode, spared)
        instances = {name for name in self.asked.objects if kind_of(name) in held}
        self._hold("S3b", instances)

    def hold_instances(self, rng: Generator, per_episode: int) -> None:
        """Hold out some instances of each kind that training shows (S3a)."""
        shown = sorted(self._instances() - self.objects)
        spared = self._new_before("S3a")
        held = _Names()
        for kind in sorted(set(map(kind_of, shown))):
            names = [name for name in shown if kind_of(name) == kind]
            count = round(SHARES["S3a"] * len(names))
            drawn = rng.permutation(names).tolist()
            held.update(list(filterfalse(spared.__contains__, drawn))[:count])
        if len(set(map(kind_of, held))) <= per_episode:
            raise UserError(
                f"the objects have instances of {per_episode} kinds or fewer, of which some could "
                "be held out. Take objects with several instances of each kind."
            )
        self._hold("S3a", held)

    def _instances(self) -> _Names:
        """Return the objects that are instances of a kind."""
        return {name for name in self.asked.objects if kind_of(name) != name}

    def _new_before(self, split: str) -> _Names:
        """Return the objects that earlier draws held out for a split."""
        return _Names().union(*[draw.new.get(split, ()) for draw in self.earlier])

    def _hold(self, split: str, names: _Names) -> None:
        self.new[split] = names
        self.objects |= names

    def _some(
        self,
        rng: Generator,
        names: list[str],
        wanted: int,
        per_episode: int,
        spared: _Names,
    ) -> _Names:
        """Draw objects or kinds such that each condition keeps half of them or more."""
        shared = []  # objects or kinds of each condition
        for condition in self.facts:
            holders = {n if n in names else kind_of(n) for n in self.holders[condition]}
            if len(holders) > 1:
                shared.append(holders)
        held = _Names()
        for name in rng.permutation(names).tolist():
            larger = held | {name}
            if len(larger) > wanted or name in spared:
                continue
            if all(2 * len(larger & some) <= len(some) for some in shared):
                held = larger
        if len(held) < wanted or len(names) - len(held) <= per_episode:
            raise UserError(
                f"{wanted} of the {len(names)} objects would have to be held out and more than "
                f"{per_episode} left, with half of the objects of each condition. Give more "
                "objects, or fewer objects per episode."
            )
        return held

    def hold_values(self, rng: Generator, per_episode: int) -> None:
        """Hold out values that a triple links to a value that stays (S4).

        They belong to enough objects for an episode of which each can be asked for.
        """
        values: _Names = set(map(attrgetter("value"), self.facts))
        links = self._links(values)
        answering = self._with_values(values)
        wanted = max(1, round(SHARES["S4"] * len(values)))
        spared = _Names().union(*[draw.values for draw in self.earlier])
        held = _Names()
        beside = 0
        for name in rng.permutation(sorted(values)).tolist():
            larger = held | {name}
            is_enough = len(larger) > wanted and beside >= per_episode - 1
            if is_enough or name in spared:
                continue
            is_linked = all(links[value] - larger for value in larger)
            if is_linked and self._with_values(values - larger) == answering:
                held = larger
                beside = self._most_beside(held)
        if beside < per_episode - 1:
            raise UserError(
                f"of the objects whose values can be held out, {beside} can stand beside another "
                f"one that is asked for, and an episode needs {per_episode - 1}. A triple must "
                "link each value to one that stays, such as (drinking, relatedTo, tea), and each "
                "object must keep another fact. Add such triples."
            )
        self.values = held

    def hold_pairs(self, rng: Generator, per_episode: int) -> None:
        """Hold out objects of each condition, at most a third of an object's conditions (S2).

        Each object keeps a fact to be asked by.
        """
        conditions_of = Counter[str]()
        facts_of = Counter[str]()
        held_of = Counter[str]()
        spared = set[tuple[Condition, str]]()
        for draw in self.earlier:
            spared.update((condition, kind_of(name)) for condition, name in draw.pairs)
        for condition, names in self.holders.items():
            kinds = set(map(kind_of, names))
            conditions_of.update(kinds)
            if not condition.is_seen and condition.value not in self.values:
                facts_of.update(kinds)
        for condition in _shuffled(rng, list(self.holders)):
            members = set(self.holders[condition]) - self.objects
            member_kinds = sorted(set(map(kind_of, members)))
            if condition.value in self.values:
                continue
            if condition.relation == OBJECT_RELATION:
                continue
            if len(member_kinds) < 2:
                continue
            free = []
            for kind in member_kinds:
                keeps_fact = condition.is_seen or facts_of[kind] > 1
                if (condition, kind) in spared:
                    continue
                if keeps_fact and held_of[kind] < conditions_of[kind] // 3:
                    free.append(kind)
            drawn = rng.permutation(free).tolist()
            drawn.sort(key=lambda kind: held_of[kind] / conditions_of[kind])
            held = drawn[: max(1, round(SHARES["S2"] * len(member_kinds)))]
            held_of.update(held)
            if not condition.is_seen:
                facts_of.subtract(held)
            for name in members:
                if kind_of(name) in held:
                    self.pairs.add((condition, name))
        if len({kind_of(name) for _, name in self.pairs}) < per_episode:
            self.pairs = set()
            raise UserError(
                f"fewer than {per_episode} objects, which an episode needs, share a condition "
                "with an object that stays. Add facts that several objects share."
            )

    def _holders_of(self, values: Collection[str]) -> list[_Names]:
        """Return the objects of each fact with one of the values."""
        holders = list[_Names]()
        for fact in self.facts:
            if fact.value in values:
                holders.append(set(self.holders[fact]))
        return holders

    def _with_values(self, values: Collection[str]) -> _Names:
        """Return the objects that some of the values belong to."""
        return _Names().union(*self._holders_of(values))

    def _most_beside(self, values: _Names) -> int:
        """Return how many objects that some of the values belong to lack one of them, at most."""
        every = self._with_values(values) - self.objects
        lacking = map(every.difference, self._holders_of(values))
        return max(map(len, lacking))

    def _links(self, values: _Names) -> dict[str, _Names]:
        """Return the values that a triple links to each value, in either direction."""
        links: dict[str, _Names] = defaultdict(set)
        for head, _, tail in self.asked.graph:
            ends = {local_name(head), local_name(tail)}
            if len(ends) == 2 and ends <= values:
                for end in ends:
                    links[end] |= ends - {end}
        return links

    @cached_property
    def asked_in_training(self) -> set[Condition]:
        """Conditions that training asks for some object; read it when all draws are done."""
        asked = set()
        may_ask = self.in_training(list(map(Query.of, self.holders)))
        for (condition, names), row in zip(self.holders.items(), may_ask, strict=True):
            if row[list(map(self._numbers.__getitem__, names))].any():
                asked.add(condition)
        return asked

    @cached_property
    def _numbers(self) -> dict[str, int]:
        """The number of each object."""
        names = self.asked.objects
        return dict(zip(names, range(len(names)), strict=True))

    def _left_out(self, queries: Sequence[Query]) -> tuple[Mask, Mask, Mask]:
        """Return what training leaves out: objects (1, O), values (Q, 1) and pairs (Q, O)."""
        objects = np.isin(self.asked.objects, list(self.objects))
        columns = defaultdict[Condition, list[int]](list)
        for condition, name in self.pairs:
            columns[condition].append(self._numbers[name])
        values = np.zeros((len(queries), 1), bool)
        pairs = np.zeros((len(queries), len(objects)), bool)
        for number, query in enumerate(queries):
            for condition in query.conditions:
                values[number] |= condition.value in self.values
                pairs[number, columns.get(condition, [])] = True
        return objects[None], values, pairs

    def in_training(self, queries: Sequence[Query]) -> Mask:
        """Return whether training may ask each query for each object, (Q, O)."""
        objects, values, pairs = self._left_out(queries)
        return ~(objects | values | pairs)

    def is_new_pair(self, queries: Sequence[Query]) -> Mask:
        """Return which are questions of S2, (Q, O)."""
        objects, values, pairs = self._left_out(queries)
        new = pairs & ~(objects | values)
        for draw in self.earlier:
            new &= ~draw.is_new_pair(queries)
        return new

    def is_new_object(self, queries: Sequence[Query]) -> Mask:
        """Return which are questions of S3, S3a or S3b, (Q, O)."""
        conditions = map(attrgetter("conditions"), queries)
        is_asked = list(map(self.asked_in_training.issuperset, conditions))
        objects, _, _ = self._left_out(queries)
        return np.array(is_asked)[:, None] & objects

    def is_new_value(self, queries: Sequence[Query]) -> Mask:
        """Return which are questions of S4, (Q, O)."""
        objects, values, pairs = self._left_out(queries)
        return values & ~(objects | pairs)


def _shuffled(rng: Generator, conditions: Sequence[Condition]) -> list[Condition]:
    order = rng.permutation(len(conditions))
    return list(map(conditions.__getitem__, order))


def draw_edits(held: HeldOutQuestions, rng: Generator) -> KnowledgeGraph:
    """Swap values of one relation: what was for drinking is for lighting, and the reverse (S5).

    Conditions that training asks are swapped in pairs that no object satisfies both of, so that
    every old answer is a new one as well.
    """
    graph = held.asked.graph
    spared = set[Condition]().union(*[draw.swapped for draw in held.earlier])
    free = []
    for condition in held.facts:
        if condition in spared:
            continue
        is_shown = not held.objects.issuperset(held.holders[condition])
        if is_shown and condition.value not in held.values:
            free.append(condition)
    wanted = max(1, round(SHARES["S5"] * len(held.facts) / 2))
    swapped = dict[Condition, Condition]()  # both of each pair, by the other one
    for first, second in combinations(_shuffled(rng, free), 2):
        if first.relation != second.relation:
            continue
        if not set(held.holders[first]).isdisjoint(held.holders[second]):
            continue
        if not swapped.keys().isdisjoint((first, second)):
            continue
        swapped[first] = second
        swapped[second] = first
        if len(swapped) == 2 * wanted:
            break
    if not swapped:
        raise UserError(
            "no two values of one relation belong to different objects, so none can be swapped. "
            "Add facts, or give an edited graph of your own."
        )
    held.swapped = set(swapped)
    triples = graph.triples
    for old, new in swapped.items():
        holders = list(map(graph.entity_id, held.holders[old]))
        is_stated = np.isin(graph.heads, holders)
        is_stated &= graph.relations == graph.relation_id(old.relation)
        is_stated &= graph.tails == graph.entity_id(old.value)
        triples[is_stated, 2] = graph.entity_id(new.value)
    return graph.with_triples(triples)
