"""Graphs in one document: JSON (lists of triples, nodes with links), GraphML and GEXF."""

import json
import warnings
from pathlib import Path
from typing import Any

from knowarm.errors import UserError, warn
from knowarm.knowledge.formats.columns import ROLES, columns_of, listed, name_of_cell
from knowarm.knowledge.formats.files import open_bytes
from knowarm.knowledge.graph.builder import GraphBuilder
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import LABEL_RELATIONS, literal
from knowarm.reading import reading

_LISTS = ("links", "edges", "relationships", "triples", "facts")
"""Keys of a JSON object under which links may lie."""


def read_json_graph(path: Path) -> KnowledgeGraph:
    """Read lists of three, or objects with keys for head, relation and tail (see `ROLES`).

    They are the whole document, or lie beside ``nodes`` under one of the keys "links", "edges", ...
    as NetworkX and D3 write them; a link may give the number of a node, or the node itself.
    """
    with reading(path, "Correct the file."), open_bytes(path) as file:
        found = json.load(file)
    links, nodes = found, []
    if isinstance(found, dict):
        links = next((found[key] for key in _LISTS if isinstance(found.get(key), list)), None)
        nodes = found.get("nodes", [])
    if not isinstance(links, list) or not isinstance(nodes, list):
        raise UserError(
            f"{path}: this JSON is neither JSON-LD nor a graph. A graph is a list of "
            '["mug", "usedFor", "drinking"], of objects with the keys head, relation and tail, or '
            'an object with such a list under "links".'
        )
    graph = _Records(path)
    for number, node in enumerate(nodes):
        graph.add_node(node.get("id", number) if isinstance(node, dict) else node, node)
    if not any(isinstance(key, int) for key in graph.nodes):  # links may count the nodes
        graph.nodes |= enumerate([*graph.nodes.values()])
    for link in links:
        graph.add_link(dict(zip(ROLES, link, strict=False)) if isinstance(link, list) else link)
    return graph.build()


def read_with_networkx(path: Path, kind: str) -> KnowledgeGraph:
    """Read "graphml" or "gexf", whose edges each have a relation such as the value "label"."""
    import networkx  # takes time to import

    with (
        reading(path, "Correct the file, or export it again."),
        open_bytes(path) as file,
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore", UserWarning)  # values without a type are read as text
        found = getattr(networkx, f"read_{kind}")(file)
    if not found.is_directed():
        raise UserError(
            f"{path}: edges without a direction are no triples. Declare the edges as directed, if "
            "they lead from source to target."
        )
    graph = _Records(path)
    for name, values in found.nodes(data=True):
        graph.add_node(name, values)
    for head, tail, values in found.edges(data=True):
        graph.add_link({**values, "head": head, "tail": tail})
    return graph.build()


class _Records:
    """Nodes and links with named values, which become a graph."""

    def __init__(self, path: Path) -> None:
        self.path, self.builder = path, GraphBuilder()
        self.nodes: dict[Any, str] = {}  # name by identifier
        self.left_out: set[str] = set()

    def add_node(self, key: Any, values: Any) -> None:
        """Add an entity with its label, by its identifier or number."""
        if not isinstance(key, str | int | float):
            raise UserError(f"{self.path}: a node is named by text or a number, not {key!r:.80}.")
        values = values if isinstance(values, dict) else {}
        name = self.nodes[key] = name_of_cell(str(key))
        self.builder.add_node(name)
        label = values.get("label", values.get("name"))
        if isinstance(label, str) and label != name:
            self.builder.add_statement(name, LABEL_RELATIONS[0], literal(label))

    def add_link(self, values: Any) -> None:
        """Add a triple."""
        keys = list(values) if isinstance(values, dict) else []
        columns = columns_of(keys, self.path)
        triple = [self._name(values[keys[i]]) for i in columns or ()]
        if columns is None or not all(triple):
            raise UserError(
                f"{self.path}: {str(values)[:80]!r} is no link with the names of a head, a "
                "relation and a tail. Name them so, or write lists of three."
            )
        self.left_out.update(key for i, key in enumerate(keys) if i not in columns)
        self.builder.add_statement(*triple)

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
        """Return the graph; say what is not in it."""
        if others := sorted(self.left_out - {"id", "key"}):
            warn(f"{self.path}: these values of links are not read: {listed(others)}.")
        return self.builder.build()
