"""Edits of a graph in words: "+ mug usedFor lighting" adds a triple, "- mug usedFor drinking"
removes one."""

import shlex
from collections.abc import Callable, Iterable
from contextlib import suppress

from knowarm.errors import UserError
from knowarm.knowledge.graph.builder import with_facts, with_triples
from knowarm.knowledge.graph.graph import KnowledgeGraph, Names
from knowarm.knowledge.graph.terms import local_name


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
        sign, head, relation, tail = words
        triple = (
            _known(head, graph.find_entity, graph.names),
            _known(relation, graph.find_relation, graph.relation_names),
            _known(tail, graph.find_entity, graph.names),
        )
        if sign == "+":
            graph = with_facts(graph, [triple])
            continue
        if triple not in graph:
            facts = [" ".join(fact) for fact in graph if fact[0] == triple[0]]
            stated = "; ".join(facts) or f"nothing about {triple[0]}"
            raise UserError(
                f"The edit {text!r} removes a triple that the graph does not hold. It states: "
                f"{stated}."
            )
        reasons = [" ".join(map(local_name, why)) for why in graph.because(triple)]
        if reasons:
            raise UserError(
                f"The edit {text!r} removes a triple that follows from others: "
                f"{'; '.join(reasons)}. Remove one of these."
            )
        graph = with_triples(graph, filter(triple.__ne__, graph.stated()))
    return graph


def _known(name: str, find: Callable[[str], int | None], names: Names) -> str:
    """Return the graph's full name, or the name itself if the graph does not hold it."""
    index = find(name)
    return name if index is None else names[index]
