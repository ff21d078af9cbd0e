"""A graph goes in; Turtle that a person can read, sorted, comes out."""

import re
from collections.abc import Iterator
from itertools import groupby
from operator import itemgetter
from pathlib import Path

from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.term import NAMESPACE, iri_of_name, is_blank, is_literal, literal, n3

PREFIXES = {
    "": NAMESPACE,
    "rdf": "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
    "rdfs": "http://www.w3.org/2000/01/rdf-schema#",
    "owl": "http://www.w3.org/2002/07/owl#",
    "skos": "http://www.w3.org/2004/02/skos/core#",
    "xsd": "http://www.w3.org/2001/XMLSchema#",
}
"""Prefixes that are used where they fit; other IRIs are written out."""

_LOCAL = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


def write_turtle(graph: KnowledgeGraph, path: Path) -> None:
    """Write triples and labels. Entities without a triple or label are not in RDF."""
    body = "".join(_subjects(graph))
    with path.open("w", encoding="utf-8") as file:
        for prefix, namespace in PREFIXES.items():
            if f"{prefix}:" in body:
                file.write(f"@prefix {prefix}: <{namespace}> .\n")
        file.write("\n" + body)


def _subjects(graph: KnowledgeGraph) -> Iterator[str]:
    labels = graph.own_labels()
    heads: dict[str, list[tuple[str, str]]] = {
        head: [(relation, tail) for _, relation, tail in triples]
        for head, triples in groupby(graph, key=itemgetter(0))
    }
    for name in sorted({*heads, *labels}):
        lines = [f"rdfs:label {literal(labels[name])}"] if name in labels else []
        for relation, facts in groupby(heads.get(name, []), key=itemgetter(0)):
            lines.append(f"{_term(relation)} {', '.join(_term(tail) for _, tail in facts)}")
        yield f"{_term(name)}\n    " + " ;\n    ".join(lines) + " .\n\n"


def _term(name: str) -> str:
    """Return a name as Turtle writes it, short where a prefix fits."""
    if is_literal(name) or is_blank(name):
        return name
    iri = iri_of_name(name)
    for prefix, namespace in PREFIXES.items():
        if iri.startswith(namespace) and _LOCAL.fullmatch(iri[len(namespace) :]):
            return f"{prefix}:{iri[len(namespace) :]}"
    return n3(name)
