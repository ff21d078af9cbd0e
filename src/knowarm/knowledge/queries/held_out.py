"""Held-out objects, values and pairs of the choose task, and edits of its graph.

Every draw keeps what training needs: conditions with objects that answer them, and objects with
facts to be asked by.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

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
    values: set[str] = field(default_factory=set)  # Values that training never asks (S4)
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
        names = self.asked.objects
        kinds = sorted({kind_of(name) for name in names if kind_of(name) != name})
        wanted = max(2, round(SHARES["S3b"] * len(kinds)))
        held = self._some(rng, kinds, wanted, per_episode)
        self._hold("S3b", {name for name in names if kind_of(name) in held})

    def hold_instances(self, rng: np.random.Generator, per_episode: int) -> None:
        """Hold out some instances of each kind that training shows (S3a)."""
        held: set[str] = set()
        in_training = sorted(set(self.asked.objects) - self.objects)
        for kind in sorted({kind_of(name) for name in in_training if kind_of(name) != name}):
            names = [name for name in in_training if kind_of(name) == kind]
            held.update(rng.permutation(names)[: round(SHARES["S3a"] * len(names))].tolist())
        if len({kind_of(name) for name in held}) <= per_episode:
            raise UserError(
                f"the objects have instances of {per_episode} kinds or fewer, of which some could "
                "be held out. Take the objects of the task families."
            )
        self._hold("S3a", held)

    def _hold(self, split: str, names: set[str]) -> None:
        self.new[split] = names
        self.objects |= names

    def _some(
        self, rng: np.random.Generator, names: list[str], wanted: int, per_episode: int
    ) -> set[str]:
        """Draw objects or kinds such that each condition keeps half of them or more."""
        holders = [{n if n in names else kind_of(n) for n in self.holders[c]} for c in self.facts]
        shared = [group for group in holders if len(group) > 1]
        held: set[str] = set()
        for index in rng.permutation(len(names)):
            new = {*held, names[index]}
            if len(new) <= wanted and all(2 * len(new & group) <= len(group) for group in shared):
                held = new
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
        answering = {name for condition in self.facts for name in self.holders[condition]}
        wanted = max(1, round(SHARES["S4"] * len(values)))
        held: set[str] = set()
        beside = 0
        for index in rng.permutation(len(values)):
            new = {*held, values[index]}
            linked = all(links[value] - new for value in new)
            left = {name for c in self.facts if c.value not in new for name in self.holders[c]}
            if (len(new) <= wanted or beside < per_episode - 1) and linked and left == answering:
                held, beside = new, self._most_beside(new)
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
        new = self.objects
        names = sorted({kind_of(name) for name in self.asked.objects})
        kinds = {c: sorted({kind_of(n) for n in held}) for c, held in self.holders.items()}
        total = {name: sum(name in group for group in kinds.values()) for name in names}
        load = dict.fromkeys(names, 0)
        facts = {
            name: sum(name in kinds[c] for c in self.facts if c.value not in self.values)
            for name in names
        }
        conditions = list(self.holders)
        for index in rng.permutation(len(conditions)):
            condition = conditions[index]
            members = [name for name in self.holders[condition] if name not in new]
            member_kinds = sorted({kind_of(name) for name in members})
            is_object = condition.relation == OBJECT_RELATION
            if condition.value in self.values or is_object or len(member_kinds) < 2:
                continue
            spare = [name for name in member_kinds if condition.is_seen or facts[name] > 1]
            free = [name for name in spare if load[name] < total[name] // 3]
            order = sorted(rng.permutation(free).tolist(), key=lambda n: load[n] / total[n])
            for name in order[: max(1, round(SHARES["S2"] * len(member_kinds)))]:
                self.pairs |= {(condition, member) for member in members if kind_of(member) == name}
                load[name] += 1
                facts[name] -= not condition.is_seen
        if len({kind_of(name) for _, name in self.pairs}) < per_episode:
            self.pairs = set()
            raise UserError(
                f"fewer than {per_episode} objects, which an episode needs, share a condition "
                "with an object that stays. Add facts that several objects share."
            )

    def _most_beside(self, values: set[str]) -> int:
        """Return how many objects that some of the values belong to lack one of them, at most."""
        held = [set(self.holders[c]) - self.objects for c in self.facts if c.value in values]
        return max((len(set().union(*held) - group) for group in held), default=0)

    def _links(self, values: list[str]) -> dict[str, set[str]]:
        """Return the values that a triple links to each value, in either direction."""
        links: dict[str, set[str]] = {value: set() for value in values}
        for head, _, tail in self.asked.graph:
            one, other = local_name(head), local_name(tail)
            if one != other and one in links and other in links:
                links[one].add(other)
                links[other].add(one)
        return links

    @cached_property
    def asked_in_training(self) -> set[Condition]:
        """Conditions that training asks for some object; read it when all draws are done."""
        return {
            c
            for c, names in self.holders.items()
            if any(self.in_training(Query((c,)), name) for name in names)
        }

    def in_training(self, query: Query, name: str) -> bool:
        """Return whether training may ask a query for an object."""
        return name not in self.objects and not any(
            c.value in self.values or (c, name) in self.pairs for c in query.conditions
        )

    def is_new_pair(self, query: Query, name: str) -> bool:
        """Return whether a query is a question of S2."""
        held = any((c, name) in self.pairs for c in query.conditions)
        values = {c.value for c in query.conditions}
        return held and name not in self.objects and not values & self.values

    def is_new_object(self, query: Query, name: str) -> bool:
        """Return whether a query is a question of S3, S3a or S3b."""
        return name in self.objects and self.asked_in_training.issuperset(query.conditions)

    def is_new_value(self, query: Query, name: str) -> bool:
        """Return whether a query is a question of S4."""
        held = any(c.value in self.values for c in query.conditions)
        is_held_pair = any((c, name) in self.pairs for c in query.conditions)
        return held and not is_held_pair and name not in self.objects


def draw_edits(held: HeldOutQuestions, rng: np.random.Generator) -> KnowledgeGraph:
    """Swap values of one relation: what was for drinking is for lighting, and the reverse (S5).

    Conditions that training asks are swapped in pairs that no object satisfies both of, so that
    every old answer is a new one as well.
    """
    graph, facts = held.asked.graph, held.facts
    free = [c for c in facts if c.value not in held.values and set(held.holders[c]) - held.objects]
    order = [free[index] for index in rng.permutation(len(free))]
    wanted = max(1, round(SHARES["S5"] * len(facts) / 2))
    swapped: list[tuple[Condition, Condition]] = []
    for place, one in enumerate(order):
        used = {condition for pair in swapped for condition in pair}
        for other in order[place + 1 :]:
            disjoint = not set(held.holders[one]) & set(held.holders[other])
            fits = one.relation == other.relation and disjoint
            if len(swapped) < wanted and fits and not {one, other} & used:
                swapped.append((one, other))
                break
    if not swapped:
        raise UserError(
            "no two values of one relation belong to different objects, so none can be swapped. "
            "Add facts, or give an edited graph of your own."
        )
    moved = dict[Triple, Triple]()
    for pair in swapped:
        relation = graph.relation_names[graph.relation_id(pair[0].relation)]
        values = [graph.names[graph.entity_id(each.value)] for each in pair]
        for condition, (old, new) in zip(pair, (values, values[::-1]), strict=True):
            heads = [graph.names[graph.entity_id(name)] for name in held.holders[condition]]
            moved |= {(head, relation, old): (head, relation, new) for head in heads}
    return with_triples(graph, [moved.get(triple, triple) for triple in graph])
