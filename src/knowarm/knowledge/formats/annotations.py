"""Administrative annotations of OBO ontologies: who wrote a term, when, and its other numbers."""

from pathlib import Path

from knowarm.errors import warn
from knowarm.knowledge.formats.columns import listed
from knowarm.knowledge.graph.builder import graph_of
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import local_name

_OBO = "http://www.geneontology.org/formats/oboInOwl#"
_NUMBERED = "http://purl.obolibrary.org/obo/IAO_"
_DUBLIN_CORE = ("http://purl.org/dc/elements/1.1/", "http://purl.org/dc/terms/")
_EDITING = {
    "0000114", "0000117", "0000119", "0000231", "0000233", "0000234", "0000412", "0100001",
}  # fmt: skip
"""Curation status, editor, source of the definition, reasons to withdraw a term, ..."""
_PEOPLE_AND_DATES = {
    "contributor", "created", "creator", "date", "issued", "license", "modified", "publisher",
}  # fmt: skip


def without_administration(graph: KnowledgeGraph, path: Path) -> KnowledgeGraph:
    """Leave the administrative annotations out of an OBO ontology, in any syntax, with a warning.

    Nobody asks for them, and their words ("id", "created by") are no knowledge of things.
    """
    if not any(name.startswith(_OBO) for name in graph.relation_names):
        return graph
    left_out = set(filter(_is_administrative, graph.relation_names))
    if not left_out:
        return graph
    kept = []
    entities = set(graph.entities)
    for triple in graph:
        head, relation, tail = triple
        if _is_administrative(head):
            entities -= {head, tail}
        elif relation in left_out:
            entities.discard(tail)
        else:
            kept.append(triple)
    names = sorted(set(map(local_name, left_out)))
    warn(
        f"{path}: {len(graph) - len(kept)} administrative annotations of OBO are left out: "
        f"{listed(names)}."
    )
    rest = graph_of(
        kept,
        nodes=entities,
        labels=graph.labels,
        confidence=graph.own_confidence(),
        prefixes=graph.prefixes,
    )
    return rest.lacking(graph.missing)


def _is_administrative(name: str) -> bool:
    """Return whether a name is that of an annotation that says nothing of the thing itself."""
    if name.startswith(_OBO):
        return not name.endswith("Synonym")
    if name.startswith(_NUMBERED):
        return name.removeprefix(_NUMBERED) in _EDITING
    return name.startswith(_DUBLIN_CORE) and local_name(name) in _PEOPLE_AND_DATES
