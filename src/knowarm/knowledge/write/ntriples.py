"""A graph goes in; N-Triples, sorted, come out."""

from pathlib import Path

from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.read.label_choice import LABEL_RELATIONS
from knowarm.knowledge.term import literal, n3


def write_ntriples(graph: KnowledgeGraph, path: Path) -> None:
    """Write triples and labels, one a line. Entities without a triple or label are not in RDF."""
    with path.open("w", encoding="utf-8") as file:
        for head, relation, tail in graph:
            file.write(f"{n3(head)} {n3(relation)} {n3(tail)} .\n")
        for name, label in sorted(graph.own_labels().items()):
            file.write(f"{n3(name)} <{LABEL_RELATIONS[0]}> {literal(label)} .\n")
