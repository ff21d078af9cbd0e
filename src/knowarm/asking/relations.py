"""Relations of kinds and colours: isA, rdf:type, rdfs:subClassOf, hasColor and their like."""

import re
from typing import NamedTuple

from knowarm.asking.lexicon import FAMILIES
from knowarm.knowledge.graph.denials import opposed, stance
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import RDF_TYPE, RDFS, label_of, name_key
from knowarm.questions import COLOUR_RELATION


class KindRelations(NamedTuple):
    """The relations of a graph that state kinds, and those that deny them, by ids."""

    stating: list[int]
    denying: list[int]


def kind_relations(graph: KnowledgeGraph) -> KindRelations:
    """Return the relations of a graph that state or deny kinds, ascending."""
    labels = graph.labels
    stating = []
    denying = {*opposed(graph, RDF_TYPE), *opposed(graph, RDFS + "subClassOf")}
    for index, name in enumerate(graph.relation_names):
        is_kind = re.search(FAMILIES["type"].relations, label_of(name, labels))
        if is_kind and not stance(name, labels.get(name, "")).denies:
            stating.append(index)
            denying.update(opposed(graph, name))
    return KindRelations(stating, sorted(denying))


def is_colour(relation: str) -> bool:
    """Return whether the last part of a relation's name is that of colours, in any spelling."""
    return name_key(relation) in (name_key(COLOUR_RELATION), name_key("hasColour"))
