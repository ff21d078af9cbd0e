"""Homonyms: which of the entities of one name an object of a task, or a value, stands for.

Equal letters are no reason: of `Mug` and `mug`, or of `http://a.org/mug` and `http://b.org/mug`,
the class is meant, or else the one about which more is stated. A `DataWarning` names the others.
"""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from knowarm.errors import UserError, warn
from knowarm.knowledge.graph.graph import Ids, KnowledgeGraph
from knowarm.knowledge.graph.names import AmbiguousNameError, Counts, several
from knowarm.knowledge.graph.terms import (
    is_iri,
    label_of,
    local_name,
    name_key,
    numbered,
)
from knowarm.reading import read_toml

_KINDS = read_toml(Path(__file__).with_name("kinds.toml"))
"""Last words of classes, of which the file tells; and relations of places."""
PLACES: str = _KINDS["places"]
"""Pattern of the names of relations that say where something is."""
_SENSE = re.compile(r"\.([nvasr])\.\d+$")
"""Sense of WordNet at the end of a name: mug.n.04, and mug.v.01, to rob."""
_TOLD = 2
"""Most names that are explained in one warning."""
_OPEN = {"NamedIndividual", "Thing", "Resource"}
"""Last parts of classes that leave open what their individuals are."""


def find_object(graph: KnowledgeGraph, name: str) -> int | None:
    """Return the id of an object as `find_objects`."""
    return find_objects(graph, [name])[name]


def find_objects(graph: KnowledgeGraph, names: Iterable[str]) -> dict[str, int | None]:
    """Return the ids of objects of a task, by their full IRIs or their names; None without.

    Warns:
        DataWarning: others have one of the names, too; several are described alike, or it is the
            name of an action or a landform: then the object counts as not described.
    """
    entities: dict[str, int | None] = {}
    notes = {}
    for name in names:
        try:
            entity, notes[name] = _object(graph, name)
        except AmbiguousNameError as error:
            entity = None
            notes[name] = f"{error} Until then it counts as not described."
        kind = "" if entity is None else unhandled(graph, entity)
        if entity is not None and kind:
            notes[name] = (
                f"{name!r} is {graph.names[entity]} in the graph, of the kind {kind!r} and no "
                "object, so it counts as not described. Give the full name to mean it."
            )
            entity = None
        entities[name] = entity
    _tell(notes)
    return entities


def named_objects(graph: KnowledgeGraph, names: Iterable[str]) -> dict[str, int | None]:
    """Return the ids of objects as `find_objects`, which may be actions.

    Raises:
        AmbiguousNameError: several are described alike.
    """
    entities = {}
    notes = {}
    for name in names:
        entities[name], notes[name] = _object(graph, name)
    _tell(notes)
    return entities


def object_ids(graph: KnowledgeGraph, names: Iterable[str]) -> list[int]:
    """Return the ids of objects as `named_objects`.

    Raises:
        AmbiguousNameError: several are described alike.
        UserError: there is none.
    """
    names = list(names)
    named = named_objects(graph, names)
    entities = []
    for name in names:
        entity = named[name]
        entities.append(described_id(graph, name) if entity is None else entity)
    return entities


def described_id(graph: KnowledgeGraph, name: str) -> int:
    """Return the id of an object that is found in another way than as `find_objects`.

    Raises:
        UserError: there is none.
    """
    try:
        return graph.entity_id(name)
    except UserError as error:
        raise UserError(
            f"The graph says nothing about the object {name!r}. {error} Add triples about it, or "
            "leave the object out of the task."
        ) from error


def _tell(notes: Mapping[str, str]) -> None:
    """Warn of the first notes on names, and of how many more there are."""
    noted = [name for name in notes if notes[name]]
    if not noted:
        return
    text = " ".join(notes[name] for name in noted[:_TOLD])
    others = noted[_TOLD:]
    if others:
        text += f" Likewise {len(others)} more names: {', '.join(others)}."
    warn(text)


def value_id(graph: KnowledgeGraph, name: str, counts: Counts) -> int | None:
    """Return the id of the value that is meant of those that count; None without.

    Of several that are described alike it is the one that is spelled like the name.

    Raises:
        AmbiguousNameError: several are spelled and described alike.

    Warns:
        DataWarning: others have the name, too.
    """
    best, others = _best(graph, name, counts)
    entity = graph.entity_spellings.find(name, "entities", best.__contains__)
    if entity is not None:
        others = [*others, *(other for other in best if other != entity)]
        _tell({name: _note(graph, name, entity, others)})
    return entity


def best_described(graph: KnowledgeGraph, name: str) -> list[int]:
    """Return the ids of a name that are described best, several if they are alike."""
    found = graph.best_described
    if name not in found:
        found[name] = tuple(_best_named(graph, name)[0])
    return list(found[name])


def short(graph: KnowledgeGraph, entity: int) -> str:
    """Return the last part of a name, or the whole where other names have its letters."""
    name = graph.names[entity]
    local = local_name(name)
    if len(graph.entity_spellings.same_name(local, graph.has_node)) > 1:
        return name
    return local


def is_class(graph: KnowledgeGraph, entity: int) -> bool:
    """Return whether something is typed by an entity or below it, or it is called a class."""
    kinds = graph.type_relations + graph.subclass_relations
    if not kinds:
        return False
    if np.isin(graph.relations[graph.in_rows(entity)], kinds).any():
        return True
    if len(_tails(graph, entity, graph.subclass_relations)):
        return True
    types = graph.names.at(_tails(graph, entity, graph.type_relations))
    return "Class" in map(local_name, types)


def unhandled(graph: KnowledgeGraph, entity: int) -> str:
    """Return which kind of an entity says that it is no object, "" if none does.

    All kinds that tell are of actions or events, or one is of landforms or the like.
    """
    relations = graph.type_relations + graph.is_a_relations + graph.subclass_relations
    kinds_of_it = graph.names.at(_tails(graph, entity, relations))
    sense = _SENSE.search(graph.names[entity])
    if sense:
        if sense[1] != "n":
            return "word that is no noun"
        kinds_of_it += _hypernyms(graph, entity)
    last_words = set()
    for name in kinds_of_it:
        if not name.startswith("_:"):
            last_words.add(label_of(name, graph.labels).split(" ")[-1])
    telling = last_words.difference(_KINDS["anything"])
    kinds = telling.intersection(_KINDS["unhandled"])
    if telling.issubset(_KINDS["deeds"]):
        kinds = telling
    return min(kinds, default="")


def _hypernyms(graph: KnowledgeGraph, entity: int) -> list[str]:
    """Return the words of all senses above one of WordNet: person of dumbbell.n.02."""
    named = enumerate(graph.relation_names)
    relations = [index for index, name in named if name.lower().endswith("hypernym")]
    above = {entity}
    waiting = [entity]
    for sense in waiting:
        for other in _tails(graph, sense, relations).tolist():
            if other not in above:
                above.add(other)
                waiting.append(other)
    return [_SENSE.sub("", name) for name in graph.names.at(waiting[1:])]


def types_of(graph: KnowledgeGraph, entity: int) -> list[int]:
    """Return the ids of the classes that are stated as types of an individual."""
    relations = graph.type_relations
    if numbered(local_name(graph.names[entity])) is not None:
        relations = relations + graph.is_a_relations
    kinds = _tails(graph, entity, relations).tolist()
    return [kind for kind in kinds if local_name(graph.names[kind]) not in _OPEN]


def _tails(graph: KnowledgeGraph, entity: int, relations: list[int]) -> Ids:
    """Return what some relations lead to from an entity, (k,)."""
    return graph.tails[graph.linking(graph.out_rows(entity), relations)]


def _object(graph: KnowledgeGraph, name: str) -> tuple[int | None, str]:
    """Return the id of an object, None without, and what is to be said of it."""
    exact = graph.names.find(name)
    if exact is not None and is_iri(name) and graph.has_node(exact):
        return exact, ""
    best, others = _best_named(graph, name)
    if len(best) > 1:
        raise several(name, "entities", graph.names.at(best))
    for entity in best:
        return entity, _note(graph, name, entity, others)
    return None, ""


def _note(graph: KnowledgeGraph, name: str, entity: int, others: list[int]) -> str:
    """Return what is to be said of a name that others have, too."""
    if not others:
        return ""
    return (
        f"{name!r} is taken for {graph.names[entity]}, and not for "
        f"{', '.join(graph.names.at(others[:5]))}. Give the full name to mean another one."
    )


def _best_named(graph: KnowledgeGraph, name: str) -> tuple[list[int], list[int]]:
    """Return the same as `_best` of those that count as of the name."""
    same = graph.entity_spellings.same_name(name, graph.has_node)
    if len(same) < 2:
        return same, []
    return _best(graph, name, _counts(graph, name, set(same)))


def _best(
    graph: KnowledgeGraph, name: str, counts: Counts
) -> tuple[list[int], list[int]]:
    """Return the ids of a name that are described best, and the others that are described."""
    same = graph.entity_spellings.same_name(name, counts)
    if len(same) < 2:
        return same, []
    merits = {}
    for entity in same:
        facts = len(graph.out_rows(entity))
        if _SENSE.search(graph.names[entity]):
            facts = 0  # Of pitcher.n.01 and n.02 none is meant the more
        is_object = not unhandled(graph, entity)
        merits[entity] = (is_object, is_class(graph, entity), facts)
    most = max(merits.values())
    best = []
    others = []
    for entity, (_, *merit) in merits.items():
        if merits[entity] == most:
            best.append(entity)
        elif any(merit):
            others.append(entity)
    return best, others


def _counts(graph: KnowledgeGraph, name: str, same: set[int]) -> Counts:
    """Return whether an id counts of several of the same name.

    None does that is called after its class, as `mug_0` with the label "mug".
    """
    key = name_key(name)

    def counts(entity: int) -> bool:
        word = numbered(local_name(graph.names[entity]))
        is_counted = word is not None and name_key(word.word) == key
        is_typed = not same.isdisjoint(types_of(graph, entity))
        return entity in same and not is_counted and not is_typed

    return counts
