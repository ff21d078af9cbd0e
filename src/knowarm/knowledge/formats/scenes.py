"""Scene graphs in JSON: VirtualHome, Spark-DSG (Hydra) and ConceptGraphs."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from typing import Any

from knowarm.errors import UserError
from knowarm.knowledge.formats.columns import name_of_cell
from knowarm.knowledge.formats.json_forms import Form, has, records_of
from knowarm.knowledge.formats.records import Records
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
    "caption": "caption",
    "object_caption": "caption",
    "category": "category",
}
"""Relations to the words in a record of a thing, by key. Colours in numbers are not read: those of
Spark-DSG stand for classes."""
TEXTS = ("caption", "category")
"""Relations to a text about a thing, which names nothing that could be asked about."""
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
_EDGES = ("edges", "links", "relations", "relationships")
_TAGS = ("object_tag", "class_name")
_KEYS = {"id", "name", "semantic_label", "type", *_TAGS, "object_1_tag", "object_2_tag"}
"""Keys that are read apart from the tables above, or that name kinds of records."""
_A_AND_B = re.compile(r"([ab]) (.+) ([ab])")
"""Relations of ConceptGraphs in either direction: "b on a"."""


class SceneRecords(Records):
    """Things of a scene: each is an individual of its class, named after both, as "mug_17"."""

    silent = _KEYS

    def add_thing(
        self, key: Any, kind: Any, record: Mapping[str, Any], number: Any = None
    ) -> None:
        """Add a thing by its identifier: its class, and what its record states.

        The name ends with the identifier, or with another number if that is free.
        """
        word = _word(kind)
        if not word:
            self.left_out["nodes without a class in words"] += 1
            return
        if key in self.names:
            raise ValueError(f"two nodes have the id {key}")
        begin = word.replace(" ", "_")
        name = f"{begin}_{number}"
        if number is None or name in self.builder.entities:
            name = f"{begin}_{key}"
        self.names[key] = name
        self.builder.add(name, RDF_TYPE, word)
        for about, value in record.items():
            self._state(name, about, value)
        for axis, coordinate in zip(AXES.values(), _position(record), strict=False):
            number = literal(repr(float(coordinate)), datatype=_DOUBLE)
            self.builder.add(name, axis, number)

    def _state(self, name: str, key: str, value: Any) -> None:
        """Add what a key of the record of a thing states; note what is not read."""
        words = value if isinstance(value, list) else [value]
        if key in RELATIONS and all(isinstance(word, str) for word in words):
            relation = RELATIONS[key]
            tails = list(filter(None, map(_word, words)))
            if relation in TEXTS:
                tails = [literal(" ".join(words))]
            for tail in tails:
                self.builder.add(name, relation, tail)
        elif key in POSITIONS and isinstance(value, dict):
            inside = value.keys() - {"position", "center", *AXES}
            self.unread.update(map(f"{key}.{{}}".format, inside))
        elif key not in (*POSITIONS, *_KEYS) and value:
            self.unread.add(key)

    def relate(self, cells: list[Any], confidence: float | None = None) -> None:
        """Add a relation of two things by their identifiers, or by records with these."""
        head, relation, tail = cells
        word = _word(relation)
        direction = _A_AND_B.fullmatch(word)
        ends = [head, tail]
        if direction is not None:
            word = direction[2]
            if direction[1] == "b":
                ends.reverse()
        head_name, tail_name = map(self.names.get, map(_identifier, ends))
        if not word:
            self.left_out["edges without a relation"] += 1
        elif head_name is None or tail_name is None:
            self.left_out["edges of nodes that are not there"] += 1
        else:
            self.add((head_name, word, tail_name), confidence)

    def build(self) -> KnowledgeGraph:
        """Return the graph; say what is not in it."""
        if not self.names:
            raise UserError(
                f"{self.where}: no node of this scene has a class in words, so nothing can be "
                "asked. Export it with the names of its classes."
            )
        return super().build()


def _word(value: Any) -> str:
    """Return the name that a class, relation or value is called by, or ""."""
    if isinstance(value, list) and value:
        value = Counter(value).most_common(1)[0][0]  # of the names in several images
    if not isinstance(value, str) or value.strip().casefold() in _UNKNOWN:
        return ""
    return name_of_cell(value)


def _identifier(end: Any) -> Any:
    """Return the identifier of an end of an edge, which may be given as a record."""
    return end["id"] if isinstance(end, dict) else end


def _position(record: Mapping[str, Any]) -> list[float]:
    """Return the three coordinates of a thing, [] without."""
    for value in map(record.get, POSITIONS):
        if isinstance(value, dict):
            value = value.get("position", value.get("center", value))
        if isinstance(value, dict):
            value = list(map(value.get, AXES))
        if isinstance(value, list) and len(value) == len(AXES) and None not in value:
            return value
    return []


def _read_spark_dsg(document: Any, scene: SceneRecords) -> None:
    """Read layers of nodes; what is in a place without a name is in what holds the place."""
    layers = {}
    for node in document["nodes"]:
        key = node["id"]
        layers[key] = node["layer"]
        number = key % (1 << _INDEX_BITS)
        scene.add_thing(key, _spark_class(node, document), node["attributes"], number)
    holders = defaultdict[int, list[int]](list)
    for edge in document.get("edges", []):
        lower, upper = sorted((edge["source"], edge["target"]), key=layers.__getitem__)
        if layers[lower] < layers[upper]:
            holders[lower].append(upper)
        elif lower in scene.names and upper in scene.names:
            scene.relate([edge["source"], "near", edge["target"]])
    for key in scene.names:
        waiting = holders[key].copy()
        for holder in waiting:
            if holder in scene.names:
                scene.relate([key, "isLocatedIn", holder])
            else:
                waiting += holders[holder]


def _spark_class(node: Mapping[str, Any], document: Any) -> str:
    """Return the class of a node: by the labels of the file, or its own name or layer's."""
    attributes = node["attributes"]
    metadata = document.get("metadata") or {}
    space = f"_l{node['layer']}p{node.get('partition', 0)}"
    labels = dict(metadata.get("labelspaces", {}).get(space, {}))
    named = {str(number): label for number, label in labels.items()}
    number = str(attributes.get("semantic_label"))
    if number in named:
        return str(named[number])
    name = str(attributes.get("name") or "")
    if _NODE_SYMBOL.fullmatch(name):
        return _LAYERS.get(node["layer"], "")
    return name


def _read_things(document: Any, scene: SceneRecords) -> None:
    """Read things, relations or both; relations may tell what their things are."""
    things = records_of(document, "nodes", "objects")
    relations = records_of(document, *_EDGES)
    if not things and not relations:
        things = records_of(document)
    for number, record in enumerate(things):
        tag = next(filter(record.__contains__, _TAGS), None)
        if tag is None:
            relations.append(record)
        else:
            scene.add_thing(record.get("id", number), record[tag], record)
    for record in relations:
        for end in _ends(record):
            if end["id"] not in scene.names:
                scene.add_thing(end["id"], end["object_tag"], end)
        scene.add_link(record)


def _has_names(value: Any) -> bool:
    """Return whether a value lists objects by their classes alone, and relations of them."""
    if not has("objects", "relationships")(value):
        return False
    objects = value["objects"]
    names = objects.values() if isinstance(objects, dict) else objects
    return all(isinstance(name, str) for name in names)


def _read_names(document: Any, scene: SceneRecords) -> None:
    """Read ``[1, 2, 14, "attached to"]`` of 3DSSG, or ``[0, "has", 1]``; lists count objects."""
    scenes = document if isinstance(document, list) else [document]
    if len(scenes) > 1:
        raise UserError(
            f"{scene.where}: holds {len(scenes)} scenes, each with objects of its own. Save one "
            "of them as a file."
        )
    (scan,) = scenes
    objects = scan["objects"]
    if isinstance(objects, list):
        objects = dict(enumerate(objects))
    for key, kind in objects.items():
        scene.add_thing(int(key), kind, {})
    for link in scan["relationships"]:
        numbers = [cell for cell in link if isinstance(cell, int)]
        relation = next(cell for cell in link if isinstance(cell, str))
        scene.relate([numbers[0], relation, numbers[1]])


def _ends(relation: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Yield the two objects of a relation of ConceptGraphs, where it describes them."""
    for number in (1, 2):
        tag = f"object_{number}_tag"
        if tag in relation:
            key = relation[f"object_{number}_id"]
            yield {"id": key, "object_tag": relation[tag]}
        elif "object1" in relation:
            yield relation[f"object{number}"]


def _things(name: str, key: str, *under: str) -> Form:
    return Form(name, _read_things, has(key), under, SceneRecords)


SCENES = (
    Form(
        "Spark-DSG",
        _read_spark_dsg,
        has("attributes", "layer"),
        ("nodes",),
        SceneRecords,
    ),
    _things("VirtualHome", "class_name", "nodes"),
    Form("3DSSG", _read_names, _has_names, (), SceneRecords),
    _things("ConceptGraphs", "object_tag", "objects"),
    _things("ConceptGraphs", "class_name", "objects"),
    _things("ConceptGraphs", "object_tag"),
    _things("ConceptGraphs", "object_relation"),
    _things("ConceptGraphs", "object_1_tag"),
)
