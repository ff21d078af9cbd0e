"""Graphs in one document: JSON (lists of triples, nodes with links), GraphML and GEXF."""

import warnings
from collections import defaultdict
from pathlib import Path
from typing import Any

from knowarm.errors import UserError, warn
from knowarm.knowledge.formats.columns import (
    ROLES,
    Statements,
    columns_of,
    confidence_key,
    confidence_of,
    listed,
    name_of_cell,
)
from knowarm.knowledge.formats.files import open_bytes
from knowarm.knowledge.formats.json_forms import json_value, plain_graph
from knowarm.knowledge.formats.scenes import read_scene
from knowarm.knowledge.graph.builder import GraphBuilder
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import LABEL_RELATIONS, RDF_TYPE, literal
from knowarm.reading import reading

_LISTS = ("links", "edges", "relationships", "triples", "facts")
"""Keys of a JSON object under which links may lie."""


def read_json_graph(path: Path) -> KnowledgeGraph:
    """Read lists of three, or objects with keys for head, relation and tail (see `ROLES`).

    They are the whole document, or lie beside ``nodes`` under one of the keys "links", "edges", ...
    as NetworkX and D3 write them; a link may give the number of a node, or the node itself. Or the
    document has a form of `json_forms`.
    """
    document = json_value(path)
    scene = read_scene(document, path)
    if scene is not None:
        return scene
    with reading(path, "Correct the file, or export it again."):
        links = plain_graph(document, path)
    nodes: Any = []
    if isinstance(links, dict):
        nodes = links.get("nodes", [])
        lists = (links[key] for key in _LISTS if isinstance(links.get(key), list))
        links = next(lists, None)
    if not isinstance(links, list) or not isinstance(nodes, list):
        raise UserError(
            f"{path}: this JSON is neither JSON-LD nor a graph. A graph is a list of "
            '["mug", "usedFor", "drinking"], of objects with the keys head, relation and tail, or '
            'an object with such a list under "links".'
        )
    graph = _Records(path)
    for number, node in enumerate(nodes):
        if isinstance(node, dict):
            graph.add_node(node.get("id", number), node)
        else:
            graph.add_node(node, {})
    # Links may count the nodes.
    if not any(isinstance(key, int) for key in graph.nodes):
        graph.nodes.update(enumerate(list(graph.nodes.values())))
    for link in links:
        if isinstance(link, list):
            link = dict(zip(ROLES, link, strict=False))
        graph.add_link(link)
    return graph.build()


def read_with_networkx(path: Path, kind: str) -> KnowledgeGraph:
    """Read "graphml", "gexf" or "gml", whose edges have a relation such as the value "label"."""
    import networkx  # takes time to import

    with (
        reading(path, "Correct the file, or export it again."),
        open_bytes(path) as file,
        warnings.catch_warnings(),
    ):
        # Values without a type are read as text
        warnings.simplefilter("ignore", UserWarning)
        options = {"label": "id"} if kind == "gml" else {}
        network = getattr(networkx, f"read_{kind}")(file, **options)
    if not network.is_directed():
        raise UserError(
            f"{path}: edges without a direction are no triples. Declare the edges as directed, if "
            "they lead from source to target."
        )
    graph = _Records(path)
    for name, values in network.nodes(data=True):
        graph.add_node(name, values)
    for head, tail, values in network.edges(data=True):
        graph.add_link({**values, "head": head, "tail": tail})
    return graph.build()


class _Records:
    """Nodes and links with named values, which become a graph."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.builder = GraphBuilder()
        self.statements = Statements(path, self.builder)
        self.nodes: dict[Any, str] = {}  # name by identifier
        self.labels = defaultdict[str, list[str]](list)  # names by label
        self.left_out: set[str] = set()
        self.named_by_keys: dict[tuple[str, ...], tuple[list[str], str | None]] = {}

    def add_node(self, key: Any, values: dict[str, Any]) -> None:
        """Add an entity with its label, by its identifier or number."""
        if not isinstance(key, str | int | float):
            raise UserError(
                f"{self.path}: a node is named by text or a number, not {key!r:.80}."
            )
        name = name_of_cell(str(key))
        self.nodes[key] = name
        self.builder.add_node(name)
        label = values.get("label", values.get("name"))
        if isinstance(label, str) and label != name:
            self.builder.add_statement(name, LABEL_RELATIONS[0], literal(label))
            self.labels[label].append(name)

    def add_link(self, values: Any) -> None:
        """Add a triple."""
        keys = tuple(values) if isinstance(values, dict) else ()
        if keys not in self.named_by_keys:
            self.named_by_keys[keys] = self._named(keys)
        named, certainty = self.named_by_keys[keys]
        triple = [self._name(values[key]) for key in named]
        confidence = None
        if certainty is not None:
            confidence = confidence_of(values[certainty], str(self.path))
        if not triple or not all(triple):
            raise UserError(
                f"{self.path}: {str(values)[:80]!r} is no link with the names of a head, a "
                "relation and a tail. Name them so, or write lists of three."
            )
        self.statements.add((triple[0], triple[1], triple[2]), confidence)

    def _named(self, keys: tuple[str, ...]) -> tuple[list[str], str | None]:
        """Return which of the keys of a link hold head, relation and tail, and confidence."""
        columns = columns_of(keys, self.path) or ()
        named = [keys[column] for column in columns]
        certainty = None
        number = confidence_key(keys)
        if number is not None and columns:
            certainty = keys[number]
        self.left_out.update(set(keys) - {*named, certainty})
        return named, certainty

    def _name(self, value: Any) -> str:
        """Return the name of a node by its identifier or number or as it is, else of a value."""
        if isinstance(value, dict):
            value = value.get("id")
        if not isinstance(value, str | int | float):
            return ""
        if isinstance(value, bool):
            return str(value).lower()
        return self.nodes.get(value) or name_of_cell(str(value))

    def build(self) -> KnowledgeGraph:
        """Return the graph; say what is not in it. Nodes with one label are individuals of it."""
        shared = {
            label: names for label, names in self.labels.items() if len(names) > 1
        }
        for label, names in shared.items():
            for name in names:
                self.builder.add(name, RDF_TYPE, label)
        if shared:
            warn(
                f"{self.path}: several nodes have one label, so they count as individuals of a "
                f"class of this name: {listed(sorted(shared)[:8])}."
            )
        others = sorted(self.left_out - {"id", "key"})
        if others:
            warn(f"{self.path}: these values of links are not read: {listed(others)}.")
        return self.statements.build()
