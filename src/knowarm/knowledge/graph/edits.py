"""Edits of a graph in words: "+ mug usedFor lighting" adds a triple, "- mug usedFor drinking"
removes one."""

import shlex
from collections.abc import Callable, Iterable
from contextlib import suppress

from knowarm.errors import UserError
from knowarm.knowledge.graph.builder import graph_of, with_facts
from knowarm.knowledge.graph.graph import KnowledgeGraph, Names


def edited(graph: KnowledgeGraph, edits: Iterable[str]) -> KnowledgeGraph:
    """Apply edits in their order; names are those of the graph, their last parts, or new ones.

    Raises:
        UserError: an edit is malformed, names several things of the graph, or removes a triple that
            the graph does not hold.
    """
    for text in edits:
        words = list[str]()
        with suppress(ValueError):
            words = shlex.split(text)
        if len(words) != 4 or words[0] not in ("+", "-"):
            raise UserError(
                f"The edit {text!r} must be + or - and a head, a relation and a tail, such as "
                "'+ mug usedFor lighting'; put names with spaces in double quotes."
            )
        head, tail = (_known(name, graph.find_entity, graph.names) for name in words[1::2])
        triple = head, _known(words[2], graph.find_relation, graph.relation_names), tail
        if words[0] == "+":
            graph = with_facts(graph, [triple])
            continue
        if triple not in graph:
            stated = "; ".join(" ".join(fact) for fact in graph if fact[0] == head)
            raise UserError(
                f"The edit {text!r} removes a triple that the graph does not hold. It states: "
                f"{stated or f'nothing about {head}'}."
            )
        kept = [fact for fact in graph if fact != triple]
        graph = graph_of(kept, **graph.beside())
    return graph


def _known(name: str, find: Callable[[str], int | None], names: Names) -> str:
    """Return the graph's full name, or the name itself if the graph does not hold it."""
    entity = find(name)
    return name if entity is None else names[entity]
