"""Sentences about subgraphs: the labels of nodes and edges in the order of the triples."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from knowarm.errors import UserError
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.terms import label_of


@dataclass(frozen=True)
class Part:
    """One label of a sentence."""

    name: str
    """The entity's or relation's name in the graph."""
    label: str
    """Its words in lower case, separated by spaces."""
    is_relation: bool
    """Whether it is the label of an edge."""


@dataclass(frozen=True, kw_only=True)
class SentenceConfig:
    """How a subgraph becomes words."""

    relation_words: bool = True
    """Whether the labels of edges are included ("mug has color red") or not ("mug red")."""
    head_once: bool = False
    """Whether an object is named once, before all its facts, or again in each fact."""
    templates: Mapping[str, str] = field(default_factory=dict)
    """Words for a relation, by its name: {"isMadeOf": "made of"}; "" leaves it out."""


PAPER = SentenceConfig()
"""The paper's form: the labels of nodes and edges, one after the other (section 4.1)."""


def sentence_parts(graph: KnowledgeGraph, config: SentenceConfig = PAPER) -> list[Part]:
    """Return the labels of a subgraph in the order of its triples: head, relation, tail names.

    Raises:
        UserError: the graph has no triple, so there is no sentence.
    """
    if not len(graph):
        asked = ", ".join(graph.entities[:8]) or "no entity"
        raise UserError(
            f"The subgraph of {asked} is empty: it holds no fact to describe. "
            f"Add facts about it, allow more relations, or take direction='both'."
        )
    parts: list[Part] = []
    last = ""
    for head, relation, tail in graph:
        if not (config.head_once and head == last):
            parts.append(Part(head, label_of(head, graph.labels), False))
        if config.relation_words:
            words = config.templates.get(relation)
            label = label_of(relation, graph.labels) if words is None else words.lower()
            if label:
                parts.append(Part(relation, label, True))
        parts.append(Part(tail, label_of(tail, graph.labels), False))
        last = head
    return parts


def sentence(graph: KnowledgeGraph, config: SentenceConfig = PAPER) -> str:
    """Return the sentence of a subgraph, e.g. "mug has color red mug has shape cylindrical"."""
    return " ".join(part.label for part in sentence_parts(graph, config))


def graph_parts(graph: KnowledgeGraph, *, relation_words: bool) -> list[Part]:
    """Return every label of a graph: its entities and, if they are included, its relations."""
    relations = graph.relations_used if relation_words else []
    named = [*((n, False) for n in graph.entities), *((n, True) for n in relations)]
    return [Part(name, label_of(name, graph.labels), is_relation) for name, is_relation in named]
