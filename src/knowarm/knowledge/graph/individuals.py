"""Individuals of classes: what the name of an object stands for in the graph of a scene."""

import re
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import cache, partial
from types import MappingProxyType
from typing import NamedTuple

from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.homonyms import (
    PLACES,
    best_described,
    find_objects,
    is_class,
    types_of,
    value_id,
)
from knowarm.knowledge.graph.terms import (
    is_iri,
    label_of,
    local_name,
    name_key,
    numbered,
)
from knowarm.questions import SURE

_COLOURS = {"hascolor", "hascolour", "color", "colour"}


class Meant(NamedTuple):
    """What the name of an object stands for in a graph, by ids."""

    entity: int | None
    """The entity of this name, which may be a class."""
    individuals: tuple[int, ...]
    """Its individuals, ascending."""


def meant(
    graph: KnowledgeGraph, objects: Iterable[str], names: Mapping[str, str]
) -> dict[str, Meant]:
    """Return what the objects of a task stand for, of those that a graph describes.

    An individual belongs to the object of its nearest class: a teapot is no pot where both are
    objects. What is an object of the task itself is no individual of another one.

    Args:
        graph: the graph.
        objects: names of the objects.
        names: the graph's names for some of them, in full if it has several of one spelling.

    Warns:
        DataWarning: the graph has several entities of one name.
    """
    objects = list(objects)
    entities = dict.fromkeys(objects)
    entities |= find_objects(graph, [name for name in objects if name not in names])
    for name in names.keys() & entities.keys():
        entities[name] = graph.find_entity(names[name])
    return with_individuals(graph, entities, names)


def with_individuals(
    graph: KnowledgeGraph,
    entities: Mapping[str, int | None],
    names: Mapping[str, str] = MappingProxyType({}),
) -> dict[str, Meant]:
    """Return what objects stand for, as `meant`, by the entities of their names."""
    individuals = {}
    for name, entity in entities.items():
        word = local_name(names.get(name, name))
        individuals[name] = set(individuals_of(graph, word, entity))
        if entity is not None:
            word = local_name(graph.names[entity])
            individuals[name].update(individuals_of(graph, word, None))
        individuals[name].difference_update(entities.values())
    all_meant = {}
    for name, entity in entities.items():
        nearer = set[int]()
        below = set() if entity is None else _subclasses(graph, entity) - {entity}
        for other in entities:
            if entities[other] in below:
                nearer |= individuals[other]
        remaining = tuple(sorted(individuals[name] - nearer))
        if remaining or entity is not None:
            all_meant[name] = Meant(entity, remaining)
    return all_meant


def individuals_of(graph: KnowledgeGraph, word: str, entity: int | None) -> list[int]:
    """Return the ids of the individuals of a class, by its word and its id, ascending."""
    individuals = set[int]()
    if entity is not None:
        for kind in _subclasses(graph, entity):
            individuals.update(_typed(graph, kind))
    key = name_key(word)

    @cache
    def is_told_of() -> bool:
        """Return whether facts are stated about the word itself; often nobody asks."""
        return _has_facts(graph, best_described(graph, word))

    for individual in graph.names.find_beginning(word):
        counted = numbered(local_name(graph.names[individual]))
        if counted is None or name_key(counted.word) != key:
            continue
        is_counted = counted.is_parted or not is_told_of()
        is_open = not is_class(graph, individual) and not types_of(graph, individual)
        if graph.has_node(individual) and is_counted and is_open:
            individuals.add(individual)
    return sorted(individuals)


def classes_of(graph: KnowledgeGraph, entity: int) -> list[int]:
    """Return the ids of the classes of an individual: its types, or what its name counts.

    Without a type `mug_0` is a mug; so is `mug1`, but not where facts are stated about `mug`.
    """
    types = types_of(graph, entity)
    counted = numbered(local_name(graph.names[entity]))
    if types or counted is None:
        return types
    best = best_described(graph, counted.word)
    if len(best) == 1 and (counted.is_parted or not _has_facts(graph, best)):
        return best
    return []


def classes_of_value(graph: KnowledgeGraph, value: int) -> list[int]:
    """Return the ids of the classes of an individual that a relation leads to; none of a class."""
    if graph.names[value].startswith('"') or is_class(graph, value):
        return []
    return classes_of(graph, value)


def may_be(graph: KnowledgeGraph, described: Meant, colour: str) -> list[int | None]:
    """Return what of all that an object stands for is seen, if it is seen in a colour.

    It is no individual of which the graph states another colour; "" is any. Without an individual
    it is the entity of its name, None if the graph has none.
    """
    individuals: list[int | None] = [
        one
        for one in described.individuals
        if not colour or _may_have(graph, one, colour)
    ]
    return individuals or [described.entity]


class Tellers:
    """Whose facts tell of an individual: its own, and those of its classes; looked up once."""

    def __init__(self, graph: KnowledgeGraph) -> None:
        self.graph = graph
        self.classes = cache(partial(classes_of, graph))
        self.stated = cache(self._stated)

    def of(self, entity: int, relations: Collection[int]) -> list[list[int]]:
        """Return the entities whose facts by relations tell of an individual, the nearest first.

        A class does not tell where an individual is, if that is stated of the individual itself.
        """
        classes = self.classes(entity)
        for relation, _ in self.stated(entity) if classes else ():
            if relation in relations and _is_place(self.graph.relation_names[relation]):
                classes = []
        return [[entity], classes] if classes else [[entity]]

    def facts(
        self, entities: Iterable[int], relations: Collection[int]
    ) -> dict[tuple[int, int], int]:
        """Return what entities state by relations: their ids, by relation and tail, once each."""
        heads: dict[tuple[int, int], int] = {}
        for entity in entities:
            for fact in self.stated(entity):
                if fact[0] in relations:
                    heads.setdefault(fact, entity)
        return heads

    def _stated(self, entity: int) -> list[tuple[int, int]]:
        """Return relation and tail of each triple about an entity."""
        rows = self.graph.out_rows(entity)
        relations = self.graph.relations[rows].tolist()
        return list(zip(relations, self.graph.tails[rows].tolist(), strict=True))


@cache
def _is_place(relation: str) -> bool:
    """Return whether a relation says where something is."""
    return re.search(PLACES, label_of(local_name(relation), {})) is not None


def _may_have(graph: KnowledgeGraph, entity: int, colour: str) -> bool:
    """Return whether an individual may be seen in a colour: that, or none, is stated of it.

    "dark red" is red; numbers and the names of other things are no colours.
    """
    wanted = name_key(colour)
    has_other = False
    for triple in graph.rows(graph.out_rows(entity)):
        _, relation, tail = triple
        is_colour = name_key(local_name(relation)) in _COLOURS
        words = label_of(tail, graph.labels)
        is_word = words.replace(" ", "").isalpha()
        if is_colour and is_word and graph.confidence.get(triple, 1) >= SURE:
            if wanted in map(name_key, words.split()):
                return True
            has_other = True
    return not has_other


def values_of(
    graph: KnowledgeGraph, value: str, counts: Callable[[int], bool]
) -> set[int]:
    """Return the ids of what a value names: entities that count, literals and individuals.

    Raises:
        AmbiguousNameError: several entities of different namespaces are described alike.

    Warns:
        DataWarning: another entity has the name, too.
    """
    exact = graph.names.find(value)
    same = graph.entity_spellings.same_name(value, counts)
    if exact is not None and is_iri(value) and counts(exact):
        same = [exact]
    namespaces = set()
    for name in graph.names.at(same):
        namespaces.add(name.removesuffix(local_name(name)))
    if not same:
        ids = set(graph.values(value))
    elif len(namespaces) == 1:
        ids = set(same)
    else:
        best = value_id(graph, value, counts)
        ids = set() if best is None else {best}
    ids.update(filter(graph.has_node, graph.names.find_literals(value)))
    for kind in (*ids, *best_described(graph, value)):
        ids.update(individuals_of(graph, value, kind))
    ids.update(individuals_of(graph, value, None))
    return ids


def _subclasses(graph: KnowledgeGraph, entity: int) -> set[int]:
    """Return a class and all below it."""
    classes = set[int]()
    new = {entity}
    while new:
        classes |= new
        for kind in tuple(new):
            new.update(_heads(graph, kind, graph.subclass_relations))
        new -= classes
    return classes


def _typed(graph: KnowledgeGraph, kind: int) -> list[int]:
    """Return the individuals whose type is a class."""
    typed = _heads(graph, kind, graph.type_relations)
    for head in _heads(graph, kind, graph.is_a_relations):
        if numbered(local_name(graph.names[head])) is not None:
            typed.append(head)
    return [head for head in typed if not is_class(graph, head)]


def _heads(graph: KnowledgeGraph, tail: int, relations: list[int]) -> list[int]:
    """Return the heads of the triples that lead to a tail by one of some relations."""
    if not relations:  # without them a large graph is never sorted by its tails
        return []
    return graph.heads[graph.linking(graph.in_rows(tail), relations)].tolist()


def _has_facts(graph: KnowledgeGraph, entities: Iterable[int]) -> bool:
    """Return whether a triple is stated about one of some entities."""
    return any(len(graph.out_rows(entity)) for entity in entities)
