"""Scene graphs in JSON: VirtualHome, Spark-DSG (Hydra) and ConceptGraphs."""

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from knowarm.errors import UserError, warn
from knowarm.knowledge.formats.columns import columns_of, listed, name_of_cell
from knowarm.knowledge.graph.builder import GraphBuilder
from knowarm.knowledge.graph.graph import KnowledgeGraph
from knowarm.knowledge.graph.terms import RDF_TYPE, literal

RELATIONS = {
    "properties": "hasProperty",
    "states": "hasState",
    "color": "hasColor",
    "colors": "hasColor",
    "colour": "hasColor",
    "colours": "hasColor",
    "material": "isMadeOf",
    "materials": "isMadeOf",
}
"""Relations to the words in a record of a thing, by key. Colours in numbers are not read: those of
Spark-DSG stand for classes."""
TEXTS = {"caption": "caption", "object_caption": "caption", "category": "category"}
"""Relations to a text about a thing, which names nothing that could be asked about, by key."""
POSITIONS = ("position", "obj_transform", "bbox_center", "bounding_box")
"""Keys of the position of a thing, or of values with one, the surest first."""
AXES = {"x": "positionX", "y": "positionY", "z": "positionZ"}
"""Relations to coordinates, in the unit and frame of the file."""
_DOUBLE = "http://www.w3.org/2001/XMLSchema#double"
_UNKNOWN = {"", "none", "unknown", "invalid", "fail", "none of these"}
"""What stands in place of a class or relation, in lower case."""
_NODE_SYMBOL = re.compile(r"\w?\(?\d*\)?")
"""Names that Spark-DSG gives to nodes: O(12)."""
_INDEX_BITS = 56
"""Bits of the number in an identifier of Spark-DSG, behind those of a letter."""
_LAYERS = {4: "room", 5: "building"}
"""Classes of nodes of Spark-DSG without one, by layer."""
LINKS = (
    ("from_id", "relation_type", "to_id"),
    ("object1", "object_relation", "object2"),
    ("object_1_id", "relationship", "object_2_id"),
    ("object_1_id", "rel_type", "object_2_id"),
)
"""Keys of head, relation and tail of an edge, besides those of `ROLES`."""
_EDGES = ("edges", "links", "relations", "relationships")
_TAGS = ("object_tag", "class_name")
_KEYS = {"id", "name", "semantic_label", "type", *_TAGS, "object_1_tag", "object_2_tag"}
"""Keys that are read apart from the table above, or that name kinds of records."""
_LOOKED_AT = 100
"""Records among which one is looked for that is recognized."""
_A_AND_B = re.compile(r"([ab]) (.+) ([ab])")
"""Relations of ConceptGraphs in either direction: "b on a"."""
_Record = Mapping[str, Any]


def read_scene(document: Any, path: Path) -> KnowledgeGraph | None:
    """Read a scene; None if the document is none of a kind in `FORMS`.

    Each thing becomes an individual of its class, named after both: "mug_17".

    Raises:
        UserError: the document holds several scenes or none with classes, or is malformed.

    Warns:
        DataWarning: something is left out.
    """
    form = _form_of(document)
    if form is None and isinstance(document, dict):
        inside = {key: part for key, part in document.items() if _form_of(part)}
        if len(inside) > 1:
            raise UserError(
                f"{path} holds {len(inside)} scenes: {listed(inside)}. Save one of them as a file."
            )
        for document in inside.values():
            form = _form_of(document)
    if form is None:
        return None
    scene = _Scene(path, form.name)
    try:
        form.read(document, scene)
        return scene.build()
    except UserError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UserError(
            f"{path}: a node or an edge of this scene of {form.name} lacks what it needs, or "
            f"states it twice ({error!r:.80}). Export the scene again."
        ) from error


class _Scene:
    """Things of a scene and what is stated about them, which become a graph."""

    def __init__(self, path: Path, form: str) -> None:
        self.path = path
        self.form = form
        self.names: dict[Any, str] = {}  # by identifier
        self._builder = GraphBuilder()
        self._links: list[tuple[Any, str, Any]] = []
        self._unread: set[str] = set()  # keys of values
        self._left_out = Counter[str]()

    def add(self, key: Any, kind: Any, record: _Record, number: Any = None) -> None:
        """Add a thing by its identifier: its class, and what its record states.

        The name ends with the identifier, or with another number if that is free.
        """
        word = _word(kind)
        if not word:
            self._left_out["nodes without a class in words"] += 1
            return
        begin = word.replace(" ", "_")
        name = f"{begin}_{key}"
        shorter = f"{begin}_{number}"
        if number is not None and shorter not in self._builder.entities:
            name = shorter
        if key in self.names:
            raise ValueError(f"two nodes have the id {key}")
        self.names[key] = name
        self._builder.add(name, RDF_TYPE, word)
        for relation, value in self._facts(record):
            self._builder.add(name, relation, value)

    def link(self, head: Any, relation: Any, tail: Any) -> None:
        """Add a relation of two things by their identifiers; they may be added later."""
        word = _word(relation)
        direction = _A_AND_B.fullmatch(word)
        if direction is not None:
            word = direction[2]
        link = (head, word, tail)
        if direction is not None and direction[1] == "b":
            link = (tail, word, head)
        self._links.append(link)

    def link_all(self, records: list[_Record]) -> None:
        """Add the relations of records."""
        for record in records:
            keys = self._keys(record)
            head, relation, tail = map(record.__getitem__, keys)
            self.link(_identifier(head), relation, _identifier(tail))
            self._unread.update(record.keys() - {*keys, *_KEYS})

    def _keys(self, edge: _Record) -> tuple[str, ...]:
        """Return the keys of head, relation and tail of an edge."""
        for keys in LINKS:
            if edge.keys() >= set(keys):
                return keys
        names = list(edge)
        columns = columns_of(names, self.path) or ()
        return tuple(map(names.__getitem__, columns))

    def build(self) -> KnowledgeGraph:
        """Return the graph; say what is not in it."""
        if not self.names:
            raise UserError(
                f"{self.path}: no node of this scene of {self.form} has a class in words, so "
                "nothing can be asked. Export it with the names of its classes."
            )
        for head, relation, tail in self._links:
            if not relation:
                self._left_out["edges without a relation"] += 1
            elif head not in self.names or tail not in self.names:
                self._left_out["edges of nodes that are not there"] += 1
            else:
                self._builder.add(self.names[head], relation, self.names[tail])
        left_out = []
        for what, count in self._left_out.items():
            left_out.append(f"{what}: {count}")
        if self._unread:
            left_out.append(f"values: {listed(sorted(self._unread))}")
        if left_out:
            warn(
                f"{self.path}: left out of this scene of {self.form}: {'; '.join(left_out)}."
            )
        return self._builder.build()

    def _facts(self, record: _Record) -> Iterator[tuple[str, str]]:
        """Yield relations and values that a record states; keep the keys of what is not read."""
        for key, value in record.items():
            words = value if isinstance(value, list) else [value]
            are_words = all(isinstance(word, str) for word in words)
            if key in RELATIONS and are_words:
                for word in filter(None, map(_word, words)):
                    yield RELATIONS[key], word
            elif key in TEXTS and are_words:
                yield TEXTS[key], literal(" ".join(words))
            elif key in POSITIONS and isinstance(value, dict):
                inside = value.keys() - {"position", "center", *AXES}
                self._unread.update(f"{key}.{inner}" for inner in inside)
            elif key not in (*POSITIONS, *_KEYS) and value:
                self._unread.add(key)
        numbers = _position(record)
        for axis, number in zip(AXES.values(), numbers, strict=False):
            yield axis, literal(repr(float(number)), datatype=_DOUBLE)


def _word(value: Any) -> str:
    """Return the name that a class, relation or value is called by, or ""."""
    if isinstance(value, list) and value:
        value = Counter(value).most_common(1)[0][0]  # of the names in several images
    if not isinstance(value, str) or value.strip().casefold() in _UNKNOWN:
        return ""
    return name_of_cell(value)


def _identifier(end: Any) -> Any:
    """Return the identifier of an end of an edge, which may be given as a record."""
    if isinstance(end, dict):
        return end["id"]
    return end


def _position(record: _Record) -> list[float]:
    """Return the three coordinates of a thing, [] without."""
    for key in POSITIONS:
        value = record.get(key)
        if isinstance(value, dict):
            value = value.get("position", value.get("center", value))
        if isinstance(value, dict):
            value = list(map(value.get, AXES))
        if isinstance(value, list) and len(value) == len(AXES) and None not in value:
            return value
    return []


def _records(document: Any, *keys: str) -> list[_Record]:
    """Return the records under some keys of a document, or of itself without keys.

    They lie in a list, or in an object with one of them per key.
    """
    places = [document]
    if keys:
        places = []
        if isinstance(document, dict):
            places = [document[key] for key in keys if key in document]
    records = []
    for values in places:
        if isinstance(values, list):
            records += values
        elif isinstance(values, dict):
            for value in values.values():
                if isinstance(value, dict):
                    records.append(value)
    return records


def _form_of(document: Any) -> "_SceneForm | None":
    """Return which of `FORMS` a document has."""
    for form in FORMS:
        for record in _records(document, *form.under)[:_LOOKED_AT]:
            if isinstance(record, dict) and form.keys <= record.keys():
                return form
    return None


def _read_virtualhome(document: Any, scene: _Scene) -> None:
    for node in _records(document, "nodes"):
        scene.add(node["id"], node["class_name"], node)
    scene.link_all(_records(document, *_EDGES))


def _read_spark_dsg(document: Any, scene: _Scene) -> None:
    """Read layers of nodes; what is in a place without a name is in what holds the place."""
    layers = {}
    for node in document["nodes"]:
        key = node["id"]
        layers[key] = node["layer"]
        number = key % (1 << _INDEX_BITS)
        scene.add(key, _spark_class(node, document), node["attributes"], number)
    holders = defaultdict[int, list[int]](list)
    for edge in document.get("edges", []):
        ends = (edge["source"], edge["target"])
        lower, upper = sorted(ends, key=layers.__getitem__)
        if layers[lower] < layers[upper]:
            holders[lower].append(upper)
        elif lower in scene.names and upper in scene.names:
            scene.link(edge["source"], "near", edge["target"])
    for key in scene.names:
        waiting = holders[key].copy()
        for holder in waiting:
            if holder in scene.names:
                scene.link(key, "isLocatedIn", holder)
            else:
                waiting += holders[holder]


def _spark_class(node: _Record, document: Any) -> str:
    """Return the class of a node: by the labels of the file, or its own name or layer's."""
    attributes = node["attributes"]
    metadata = document.get("metadata") or {}
    space = f"_l{node['layer']}p{node.get('partition', 0)}"
    labels = dict(metadata.get("labelspaces", {}).get(space, {}))
    label = attributes.get("semantic_label")
    for key in (label, str(label)):
        if key in labels:
            return str(labels[key])
    name = attributes.get("name") or ""
    if not _NODE_SYMBOL.fullmatch(name):
        return str(name)
    return _LAYERS.get(node["layer"], "")


def _read_concept_graphs(document: Any, scene: _Scene) -> None:
    """Read objects, relations or both; relations tell what their objects are."""
    objects = _records(document, "objects")
    relations = _records(document, *_EDGES)
    if not objects and not relations:
        objects = _records(document)
    for number, record in enumerate(objects):
        tag = next(filter(record.__contains__, _TAGS), None)
        if tag is None:
            relations.append(record)
        else:
            scene.add(record.get("id", number), record[tag], record)
    for record in relations:
        for end in _ends(record):
            if end["id"] not in scene.names:
                scene.add(end["id"], end["object_tag"], end)
    scene.link_all(relations)


def _ends(relation: _Record) -> list[_Record]:
    """Return the two objects of a relation of ConceptGraphs, [] where it does not describe them."""
    if "object1" in relation:
        return [relation["object1"], relation["object2"]]
    ends: list[_Record] = []
    for number in (1, 2):
        if f"object_{number}_tag" in relation:
            tag = relation[f"object_{number}_tag"]
            ends.append({"id": relation[f"object_{number}_id"], "object_tag": tag})
    return ends


class _SceneForm(NamedTuple):
    """A kind of files."""

    name: str
    under: tuple[str, ...]
    """Key under which records lie; () for those that are the document."""
    keys: frozenset[str]
    """Keys by which a record is recognized: it has them all."""
    read: Callable[[Any, _Scene], None]


def _concept_graphs(*under: str, key: str) -> _SceneForm:
    return _SceneForm("ConceptGraphs", under, frozenset({key}), _read_concept_graphs)


FORMS = (
    _SceneForm(
        "VirtualHome", ("nodes",), frozenset({"id", "class_name"}), _read_virtualhome
    ),
    _SceneForm(
        "Spark-DSG", ("nodes",), frozenset({"attributes", "layer"}), _read_spark_dsg
    ),
    _concept_graphs("objects", key="object_tag"),
    _concept_graphs("objects", key="class_name"),
    _concept_graphs(key="object_tag"),
    _concept_graphs(key="object_relation"),
    _concept_graphs(key="object_1_tag"),
)
