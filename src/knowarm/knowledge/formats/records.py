"""Triples as a file holds them, in rows or in nodes and links, and what of it is left out."""

from collections import Counter, defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from knowarm.errors import UserError, warn
from knowarm.knowledge.formats.columns import (
    ROLES,
    columns_of,
    confidence_of,
    listed,
    name_of_cell,
)
from knowarm.knowledge.graph.builder import GraphBuilder
from knowarm.knowledge.graph.graph import KnowledgeGraph, Triple
from knowarm.knowledge.graph.terms import LABEL_RELATIONS, RDF_TYPE, literal


class Statements:
    """Triples of a file.

    Attributes:
        where: the file, for messages.
        builder: the graph.
        unread: names of columns, keys and properties that are not read.
        left_out: how often something is left out.
    """

    def __init__(self, path: Path, form: str = "") -> None:
        self.where = str(path)
        if form:
            self.where += f" (read as {form})"
        self.builder = GraphBuilder()
        self.unread = set[str]()
        self.left_out = Counter[str]()

    def add(self, triple: Triple, confidence: float | None = None) -> None:
        """Add a triple; one that is stated several times is as certain as the surest time."""
        if confidence == 0:
            self.left_out["facts of confidence 0, which state nothing"] += 1
            return
        self.builder.add_statement(*triple)
        if confidence is not None:
            self.note_confidence(triple, confidence)

    def note_confidence(self, triple: Triple, confidence: float) -> None:
        """Note the confidence of a triple, or keep a larger one."""
        known = self.builder.confidence.get(triple, 0.0)
        self.builder.confidence[triple] = max(known, confidence)

    def add_label(self, name: str, label: str) -> None:
        """Add the label of an entity or relation."""
        self.builder.add_statement(name, LABEL_RELATIONS[0], literal(label))

    def warn_of_left_out(self) -> None:
        """Say what is not in the graph."""
        left_out = [f"{count} {what}" for what, count in self.left_out.items()]
        if self.unread:
            names = listed(sorted(self.unread))
            left_out.append(f"values that are not read: {names}")
        if left_out:
            warn(f"{self.where}: left out are {'; '.join(left_out)}.")

    def build(self) -> KnowledgeGraph:
        """Return the graph; say what is not in it."""
        self.warn_of_left_out()
        return self.builder.build()


class Records(Statements):
    """Nodes and links with named values."""

    silent: ClassVar = {"id", "key"}
    """Keys of nodes and links that hold nothing to be read."""

    def __init__(self, path: Path, form: str = "") -> None:
        super().__init__(path, form)
        self.names: dict[Any, str] = {}  # by identifier
        self.labeled = defaultdict[str, set[str]](set)  # names by label

    def add_node(self, key: Any, values: Mapping[str, Any]) -> None:
        """Add an entity with its label, by its identifier or number."""
        if not isinstance(key, str | int | float):
            raise UserError(
                f"{self.where}: a node is named by text or a number, not {key!r:.80}."
            )
        name = name_of_cell(str(key))
        self.names[key] = name
        self.builder.add_node(name)
        label = values.get("label", values.get("name"))
        self.unread.update(values.keys() - self.silent - {"label", "name"})
        if isinstance(label, str) and label != name:
            self.add_label(name, label)
            self.labeled[label].add(name)

    def add_link(self, values: Any) -> None:
        """Add a triple: a list of three, or values whose keys name them as columns of a table."""
        if isinstance(values, list) and len(values) == len(ROLES):
            values = dict(zip(ROLES, values, strict=True))
        columns = None
        if isinstance(values, dict):
            columns = columns_of(tuple(values), self.where)
        if columns is None:
            raise self._no_link(values)
        cells = list(values.values())
        confidence = confidence_of(columns, cells, self.where)
        self.unread.update({*columns.others} - self.silent)
        self.relate([cells[column] for column in columns.triple], confidence)

    def relate(self, cells: list[Any], confidence: float | None = None) -> None:
        """Add a triple of identifiers of nodes, or of other values."""
        head, relation, tail = map(self._name, cells)
        if not (head and relation and tail):
            raise self._no_link(cells)
        self.add((head, relation, tail), confidence)

    def _no_link(self, values: Any) -> UserError:
        return UserError(
            f"{self.where}: {str(values)[:80]!r} is no link with the names of a head, a relation "
            "and a tail. Name them so, or write lists of three."
        )

    def _name(self, value: Any) -> str:
        """Return the name of a node by its identifier or number or as it is, else of a value."""
        if isinstance(value, dict):
            value = value.get("id")
        if not isinstance(value, str | int | float):
            return ""
        if isinstance(value, bool):
            return str(value).lower()
        return self.names.get(value) or name_of_cell(str(value))

    def build(self) -> KnowledgeGraph:
        """Return the graph; say what is not in it. Nodes with one label are individuals of it."""
        shared = []
        for label, names in self.labeled.items():
            if len(names) > 1:
                shared.append(label)
                for name in names:
                    self.builder.add(name, RDF_TYPE, label)
        if shared:
            warn(
                f"{self.where}: several nodes have one label, so they count as individuals of a "
                f"class of this name: {listed(sorted(shared)[:8])}."
            )
        return super().build()
