"""Held-out objects, values and pairs of the choose task, and edits of its graph.

Every draw keeps what training needs: conditions with objects that answer them, and objects with
facts to be asked by.
"""

from collections import Counter, defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.graph.builder import with_triples
from knowarm.knowledge.graph.graph import KnowledgeGraph, Triple
from knowarm.knowledge.graph.terms import local_name
from knowarm.knowledge.queries.queries import QueryGraph
from knowarm.questions import OBJECT_RELATION, Condition, Query, kind_of

SHARES = {"S2": 0.2, "S3": 0.23, "S3a": 0.25, "S3b": 0.25, "S4": 0.15, "S5": 0.2}
"""Share that a split holds out or changes: of the objects of each condition (S2), of the objects
(S3), of the instances of each kind (S3a), of the kinds (S3b), of the values (S4), of the conditions
that are not colours (S5)."""


@dataclass
class HeldOutQuestions:
    """What training leaves out; each draw adds to it."""

    asked: QueryGraph
    holders: Mapping[Condition, list[str]]  # Objects that satisfy each condition
    # Objects that training never shows, by the split that tests them (S3, S3a, S3b)
    new: dict[str, set[str]] = field(default_factory=dict)
    objects: set[str] = field(default_factory=set)  # All of these
    values: set[str] = field(
        default_factory=set
    )  # Values that training never asks (S4)
    # Conditions and objects that training never asks together (S2)
    pairs: set[tuple[Condition, str]] = field(default_factory=set)

    @property
    def facts(self) -> list[Condition]:
        """The conditions that the graph answers."""
        return [condition for condition in self.holders if not condition.is_seen]

    def hold_objects(self, rng: np.random.Generator, per_episode: int) -> None:
        """Hold out objects; each condition keeps half of its objects or more (S3)."""
        names = sorted(self.asked.objects)
        wanted = max(per_episode + 1, round(SHARES["S3"] * len(names)))
        self._hold("S3", self._some(rng, names, wanted, per_episode))

    def hold_kinds(self, rng: np.random.Generator, per_episode: int) -> None:
        """Hold out all instances of some kinds; each condition keeps half of its kinds (S3b)."""
        kinds = {kind_of(name) for name in self.asked.objects if kind_of(name) != name}
        wanted = max(2, round(SHARES["S3b"] * len(kinds)))
        held = self._some(rng, sorted(kinds), wanted, per_episode)
        self._hold(
            "S3b", {name for name in self.asked.objects if kind_of(name) in held}
        )

    def hold_instances(self, rng: np.random.Generator, per_episode: int) -> None:
        """Hold out some instances of each kind that training shows (S3a)."""
        instances: dict[str, list[str]] = defaultdict(list)
        for name in sorted(set(self.asked.objects) - self.objects):
            if kind_of(name) != name:
                instances[kind_of(name)].append(name)
        held: set[str] = set()
        for _, names in sorted(instances.items()):
            count = round(SHARES["S3a"] * len(names))
            held.update(rng.permutation(names)[:count].tolist())
        if len(set(map(kind_of, held))) <= per_episode:
            raise UserError(
                f"the objects have instances of {per_episode} kinds or fewer, of which some could "
                "be held out. Take objects with several instances of each kind."
            )
        self._hold("S3a", held)

    def _hold(self, split: str, names: set[str]) -> None:
        self.new[split] = names
        self.objects |= names

    def _some(
        self,
        rng: np.random.Generator,
        names: list[str],
        wanted: int,
        per_episode: int,
    ) -> set[str]:
        """Draw objects or kinds such that each condition keeps half of them or more."""
        shared = list[set[str]]()  # objects or kinds of each condition
        for condition in self.facts:
            holders = {n if n in names else kind_of(n) for n in self.holders[condition]}
            if len(holders) > 1:
                shared.append(holders)
        held: set[str] = set()
        for index in rng.permutation(len(names)):
            larger = held | {names[index]}
            keeps_half = all(
                2 * len(larger & holders) <= len(holders) for holders in shared
            )
            if len(larger) <= wanted and keeps_half:
                held = larger
        if len(held) < wanted or len(names) - len(held) <= per_episode:
            raise UserError(
                f"{wanted} of the {len(names)} objects would have to be held out and more than "
                f"{per_episode} left, with half of the objects of each condition. Give more "
                "objects, or fewer objects per episode."
            )
        return held

    def hold_values(self, rng: np.random.Generator, per_episode: int) -> None:
        """Hold out values that a triple links to a value that stays (S4).

        They belong to enough objects for an episode of which each can be asked for.
        """
        values = sorted({condition.value for condition in self.facts})
        links = self._links(values)
        answering = self._holders_of(values)
        wanted = max(1, round(SHARES["S4"] * len(values)))
        held: set[str] = set()
        beside = 0
        for index in rng.permutation(len(values)):
            larger = held | {values[index]}
            is_small = len(larger) <= wanted or beside < per_episode - 1
            is_linked = all(links[value] - larger for value in larger)
            if (
                is_small
                and is_linked
                and self._holders_of(set(values) - larger) == answering
            ):
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

    def hold_pairs(self, rng: np.random.Generator, per_episode: int) -> None:
        """Hold out objects of each condition, at most a third of an object's conditions (S2).

        Each object keeps a fact to be asked by.
        """
        conditions_of = Counter[str]()
        facts_of = Counter[str]()
        held_of = Counter[str]()
        for condition, names in self.holders.items():
            kinds = set(map(kind_of, names))
            conditions_of.update(kinds)
            if not condition.is_seen and condition.value not in self.values:
                facts_of.update(kinds)
        conditions = list(self.holders)
        for index in rng.permutation(len(conditions)):
            condition = conditions[index]
            members = [
                name for name in self.holders[condition] if name not in self.objects
            ]
            member_kinds = sorted(set(map(kind_of, members)))
            is_object = condition.relation == OBJECT_RELATION
            if condition.value in self.values or is_object or len(member_kinds) < 2:
                continue
            free = list[str]()
            for kind in member_kinds:
                keeps_fact = condition.is_seen or facts_of[kind] > 1
                if keeps_fact and held_of[kind] < conditions_of[kind] // 3:
                    free.append(kind)
            drawn = rng.permutation(free).tolist()
            drawn.sort(key=lambda kind: held_of[kind] / conditions_of[kind])
            for kind in drawn[: max(1, round(SHARES["S2"] * len(member_kinds)))]:
                self.pairs.update(
                    (condition, name) for name in members if kind_of(name) == kind
                )
                held_of[kind] += 1
                if not condition.is_seen:
                    facts_of[kind] -= 1
        if len({kind_of(name) for _, name in self.pairs}) < per_episode:
            self.pairs = set()
            raise UserError(
                f"fewer than {per_episode} objects, which an episode needs, share a condition "
                "with an object that stays. Add facts that several objects share."
            )

    def _most_beside(self, values: set[str]) -> int:
        """Return how many objects that some of the values belong to lack one of them, at most."""
        holders = list[set[str]]()
        for condition in self.facts:
            if condition.value in values:
                holders.append(set(self.holders[condition]) - self.objects)
        every = set[str]().union(*holders)
        return max((len(every - names) for names in holders), default=0)

    def _holders_of(self, values: Collection[str]) -> set[str]:
        """Return the objects that some of the values belong to."""
        conditions = [
            condition for condition in self.facts if condition.value in values
        ]
        return set[str]().union(*map(self.holders.__getitem__, conditions))

    def _links(self, values: list[str]) -> dict[str, set[str]]:
        """Return the values that a triple links to each value, in either direction."""
        links: dict[str, set[str]] = {value: set() for value in values}
        for triple in self.asked.graph:
            head = local_name(triple[0])
            tail = local_name(triple[2])
            if head != tail and head in links and tail in links:
                links[head].add(tail)
                links[tail].add(head)
        return links

    @cached_property
    def asked_in_training(self) -> set[Condition]:
        """Conditions that training asks for some object; read it when all draws are done."""
        asked = set[Condition]()
        for condition, names in self.holders.items():
            query = Query((condition,))
            if any(self.in_training(query, name) for name in names):
                asked.add(condition)
        return asked

    def in_training(self, query: Query, name: str) -> bool:
        """Return whether training may ask a query for an object."""
        is_held = (
            name in self.objects
            or self._asks_value(query)
            or self._asks_pair(query, name)
        )
        return not is_held

    def is_new_pair(self, query: Query, name: str) -> bool:
        """Return whether a query is a question of S2."""
        is_pair = self._asks_pair(query, name) and not self._asks_value(query)
        return is_pair and name not in self.objects

    def is_new_object(self, query: Query, name: str) -> bool:
        """Return whether a query is a question of S3, S3a or S3b."""
        return name in self.objects and self.asked_in_training.issuperset(
            query.conditions
        )

    def is_new_value(self, query: Query, name: str) -> bool:
        """Return whether a query is a question of S4."""
        is_value = self._asks_value(query) and not self._asks_pair(query, name)
        return is_value and name not in self.objects

    def _asks_value(self, query: Query) -> bool:
        """Return whether a query has a condition whose value is held out."""
        return any(condition.value in self.values for condition in query.conditions)

    def _asks_pair(self, query: Query, name: str) -> bool:
        """Return whether a query has a condition that is held out together with an object."""
        return any((condition, name) in self.pairs for condition in query.conditions)


def draw_edits(held: HeldOutQuestions, rng: np.random.Generator) -> KnowledgeGraph:
    """Swap values of one relation: what was for drinking is for lighting, and the reverse (S5).

    Conditions that training asks are swapped in pairs that no object satisfies both of, so that
    every old answer is a new one as well.
    """
    graph = held.asked.graph
    free = list[Condition]()
    for condition in held.facts:
        if (
            condition.value not in held.values
            and set(held.holders[condition]) - held.objects
        ):
            free.append(condition)
    order = [free[index] for index in rng.permutation(len(free))]
    wanted = max(1, round(SHARES["S5"] * len(held.facts) / 2))
    swapped = dict[Condition, Condition]()  # both of each pair, by the other one
    for first, second in combinations(order, 2):
        is_disjoint = set(held.holders[first]).isdisjoint(held.holders[second])
        is_free = first not in swapped and second not in swapped
        fits = first.relation == second.relation and is_disjoint and is_free
        if fits and len(swapped) < 2 * wanted:
            swapped[first] = second
            swapped[second] = first
    if not swapped:
        raise UserError(
            "no two values of one relation belong to different objects, so none can be swapped. "
            "Add facts, or give an edited graph of your own."
        )
    moved = dict[Triple, Triple]()
    for old, new in swapped.items():
        relation = graph.relation_names[graph.relation_id(old.relation)]
        old_value = graph.names[graph.entity_id(old.value)]
        new_value = graph.names[graph.entity_id(new.value)]
        for name in held.holders[old]:
            head = graph.names[graph.entity_id(name)]
            moved[head, relation, old_value] = (head, relation, new_value)
    return with_triples(graph, [moved.get(triple, triple) for triple in graph])
