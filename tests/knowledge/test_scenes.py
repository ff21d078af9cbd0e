"""Scene graphs of VirtualHome, Spark-DSG, ConceptGraphs and 3DSSG, and nodes with one label."""

import json
import warnings

import pytest

from knowarm.cli.main import main
from knowarm.errors import DataWarning, UserError
from knowarm.knowledge import read_graph
from knowarm.knowledge.graph.terms import RDF_TYPE, local_name

OBJECTS = ("mug", "bowl", "wine_glass", "book")


def save(tmp_path, document, name="scene.json"):
    path = tmp_path / name
    path.write_text(json.dumps(document))
    return path


def facts(path):
    """Return the triples of a file with the last parts of their names."""
    return {tuple(map(local_name, triple)) for triple in read_graph(path)}


def answers(capsys, path, question):
    """Return the objects that `knowarm answer` prints."""
    out = path.with_name("answers.json")
    options = ["--graph", str(path), "--objects", *OBJECTS, "--json", str(out)]
    code = main(["answer", question, *options])
    assert code == 0, capsys.readouterr().err
    return {name for name, _ in json.loads(out.read_text())["answers"]}


def symbol(letter, number):
    """Return the identifier of a node as Spark-DSG makes it."""
    return (ord(letter) << 56) + number


def home(**changes):
    nodes = [
        {
            "id": 1,
            "class_name": "mug",
            "properties": ["GRABBABLE"],
            "states": ["CLEAN"],
        },
        {"id": 2, "class_name": "table", "properties": [], "states": []},
        {"id": 3, "class_name": "mug"},
        {"id": 4, "class_name": "bowl", "category": "Props"},
        {"id": 5, "class_name": "wine glass", "color": "red"},
    ]
    edges = [
        {"from_id": 1, "relation_type": "ON", "to_id": 2},
        {"from_id": 4, "relation_type": "ON", "to_id": 2},
        {"from_id": 5, "relation_type": "INSIDE", "to_id": 4},
    ]
    return {"nodes": nodes, "edges": edges, **changes}


def test_virtualhome(tmp_path, capsys):
    path = save(tmp_path, home())
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # nothing is left out
        assert facts(path) == {
            ("mug_1", "type", "mug"),
            ("mug_1", "hasProperty", "GRABBABLE"),
            ("mug_1", "hasState", "CLEAN"),
            ("mug_1", "ON", "table_2"),
            ("table_2", "type", "table"),
            ("mug_3", "type", "mug"),
            ("bowl_4", "type", "bowl"),
            ("bowl_4", "category", "Props"),
            ("bowl_4", "ON", "table_2"),
            ("wine_glass_5", "type", "wine glass"),
            ("wine_glass_5", "hasColor", "red"),
            ("wine_glass_5", "INSIDE", "bowl_4"),
        }
    assert answers(capsys, path, "something on the table") == {"mug", "bowl"}
    assert answers(capsys, path, "ON table and is mug") == {"mug"}
    assert answers(capsys, path, "INSIDE bowl") == {"wine_glass"}
    assert answers(capsys, path, "INSIDE (ON table)") == {"wine_glass"}
    assert answers(capsys, path, "hasState clean") == {"mug"}
    assert answers(capsys, path, "not ON table and is mug") == {"mug"}  # the other one


def test_positions_are_numbers_and_the_rest_is_said(tmp_path, capsys):
    place = {"position": [1, 0.5, -2], "rotation": [0, 0, 0, 1]}
    first = {
        "id": 1,
        "class_name": "mug",
        "prefab_name": "MG_1",
        "obj_transform": place,
    }
    box = {"center": [3, 0, 0], "size": [1, 1, 1]}
    second = {"id": 2, "class_name": "bowl", "bounding_box": box}
    third = {"id": 3, "class_name": "book", "position": {"x": 5, "y": 0, "z": 0}}
    path = save(tmp_path, {"nodes": [first, second, third], "edges": []})
    unread = "bounding_box.size, obj_transform.rotation, prefab_name"
    left_out = rf"\(read as VirtualHome\): left out are values .* not read: {unread}."
    with pytest.warns(DataWarning, match=left_out):
        stated = facts(path)
    assert ("mug_1", "positionY", "0.5") in stated
    assert ("mug_1", "positionZ", "-2.0") in stated
    assert answers(capsys, path, "positionX > 2") == {"bowl", "book"}
    assert answers(capsys, path, "positionX > 2 and positionX < 4") == {"bowl"}


def dsg(**changes):
    def node(letter, number, layer, **attributes):
        return {
            "id": symbol(letter, number),
            "layer": layer,
            "partition": 0,
            "attributes": attributes,
        }

    nodes = [
        node("O", 0, 2, name="O(0)", semantic_label=3, position=[1, 2, 3]),
        node("O", 1, 2, name="O(1)", semantic_label=3),
        node("O", 2, 2, name="O(2)", semantic_label=8),
        node("O", 3, 2, name="book", semantic_label=99),
        node("p", 7, 3, name="", semantic_label=0),
        node("p", 8, 3, name="", semantic_label=0),
        node("R", 0, 4, name="R(0)", semantic_label=0),
        node("R", 1, 4, name="R(1)", semantic_label=5),
        node("B", 0, 5, name="B(0)", semantic_label=0),
    ]
    pairs = [
        ("p7", "O0"), ("R0", "p7"), ("p8", "O1"), ("p8", "p7"), ("R1", "p8"), ("B0", "R0"),
        ("O1", "O2"), ("R0", "R1"), ("R1", "O3"),
    ]  # fmt: skip
    edges = []
    for source, target in pairs:
        ends = [symbol(end[0], int(end[1:])) for end in (source, target)]
        edges.append({"source": ends[0], "target": ends[1], "info": {"weight": 1}})
    labels = {"_l2p0": [[3, "mug"], [8, "bowl"]], "_l4p0": [[0, "kitchen"]]}
    graph = {"directed": False, "multigraph": False, "layer_names": {}, "mesh": None}
    return {
        **graph,
        "metadata": {"labelspaces": labels},
        "nodes": nodes,
        "edges": edges,
        **changes,
    }


def test_spark_dsg(tmp_path, capsys):
    path = save(tmp_path, dsg())
    with pytest.warns(DataWarning, match="2 nodes without a class in words"):
        stated = facts(path)
    assert {fact for fact in stated if "position" not in fact[1]} == {
        ("mug_0", "type", "mug"),
        ("mug_0", "isLocatedIn", "kitchen_0"),
        ("mug_1", "type", "mug"),
        ("mug_1", "isLocatedIn", "room_1"),
        ("mug_1", "near", "bowl_2"),
        ("bowl_2", "type", "bowl"),
        ("book_3", "type", "book"),
        ("book_3", "isLocatedIn", "room_1"),
        ("kitchen_0", "type", "kitchen"),
        ("kitchen_0", "isLocatedIn", "building_0"),
        ("kitchen_0", "near", "room_1"),
        ("room_1", "type", "room"),
        ("building_0", "type", "building"),
    }
    assert ("mug_0", "positionZ", "3.0") in stated
    assert answers(capsys, path, "something in the kitchen") == {"mug"}
    assert answers(capsys, path, "isLocatedIn room") == {"mug", "book"}
    assert answers(capsys, path, "near bowl") == {"mug"}
    as_object = {"_l2p0": {"3": "mug", "8": "bowl"}}
    path = save(tmp_path, dsg(metadata={"labelspaces": as_object}))
    with pytest.warns(DataWarning, match="2 nodes without a class in words"):
        assert ("room_0", "isLocatedIn", "building_0") in facts(path)


def test_numbers_alone_are_no_classes(tmp_path):
    document = dsg(metadata={})
    document["nodes"] = document["nodes"][:3]
    document["edges"] = []
    with pytest.raises(
        UserError, match=r"\(read as Spark-DSG\): no node .* has a class in words"
    ):
        read_graph(save(tmp_path, document))


MUG = {"id": 3, "object_tag": "mug", "bbox_center": [1, 2, 3], "bbox_extent": [1, 1, 1]}
TABLE = {
    "id": 4,
    "object_tag": "table",
    "bbox_center": [1, 2, 2],
    "bbox_extent": [1, 1, 1],
}
ON = ("mug_3", "on", "table_4")


@pytest.mark.parametrize(
    ("document", "expected"),
    [
        ([{**MUG, "caption": "a red mug", "possible_tags": ["cup"]}, TABLE],
         ("mug_3", "caption", "a red mug")),
        ({"object_1": {**MUG, "object_caption": "a mug", "bbox_volume": 0.1}},
         ("mug_3", "caption", "a mug")),
        ([{"object1": MUG, "object2": TABLE, "object_relation": "a on b", "reason": "x"}], ON),
        ([{"object1": TABLE, "object2": MUG, "object_relation": "b on a", "reason": "x"}], ON),
        ({"edge_0": {"edge_id": 0, "edge_description": "mug on table", "object_1_id": 3,
                     "object_1_tag": "mug", "object_2_id": 4, "object_2_tag": "table",
                     "relationship": "on"}}, ON),
        ({"edge_0": {"object_1_id": 3, "object_1_tag": "mug", "object_2_id": 4,
                     "object_2_tag": "table", "rel_type": "on"}}, ON),
        ({"objects": [MUG, TABLE], "edges": [{"source": 3, "target": 4, "relation": "on"}]}, ON),
        ({"objects": {"0": {"id": 3, "class_name": ["mug", "cup", "mug"], "colors": ["red"]}}},
         ("mug_3", "hasColor", "red")),
        ({"objects": [{"class_name": "bowl"}, {"class_name": "mug", "materials": ["clay"]}]},
         ("mug_1", "isMadeOf", "clay")),
    ],
)  # fmt: skip
def test_concept_graphs(tmp_path, document, expected):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        stated = facts(save(tmp_path, document))
    assert expected in stated
    assert (expected[0], "type", "mug") in stated


def test_concept_graphs_are_asked_over_two_files(tmp_path, capsys):
    objects = save(tmp_path, [{**MUG, "caption": "a mug"}, TABLE], "objects.json")
    relation = {"object1": MUG, "object2": TABLE, "object_relation": "a on b"}
    none = {
        "object1": MUG,
        "object2": {**TABLE, "id": 9},
        "object_relation": "none of these",
    }
    invalid = {
        "object1": MUG,
        "object2": {"id": 8, "object_tag": "invalid"},
        "object_relation": "a in b",
    }
    relations = save(tmp_path, [relation, none, invalid], "relations.json")
    whole = tmp_path / "whole.ttl"
    files = ["--graph", str(objects), "--union", str(relations), "--out", str(whole)]
    assert main(["knowledge", "subgraph", *files]) == 0
    said = capsys.readouterr().err
    assert "1 edges without a relation" in said
    assert "1 edges of nodes that are not there" in said
    assert "bbox_extent" in said
    assert answers(capsys, whole, "on table") == {"mug"}


@pytest.mark.parametrize(
    ("document", "message"),
    [
        (home(nodes=[{"id": 1, "class_name": ""}], edges=[]), "has a class in words"),
        (home(nodes=[{"id": 1, "class_name": "mug"}] * 2), "two nodes have the id 1"),
        (home(edges=[{"from_id": 1}]), "is no link with the names of a head"),
        (
            home(edges=[{"from_id": 1, "relation_type": "ON", "to_id": [2]}]),
            "is damaged or of another format",
        ),
        (
            home(nodes=[{"id": 1, "class_name": "mug"}, {"id": 2}]),
            "{'id': 2}.* is no link",
        ),
        (
            {"init_graph": home(), "final_graph": home()},
            "holds 2 graphs: init_graph, final_graph",
        ),
        (dsg(edges=[{"source": 1, "target": 2}]), "is damaged or of another format"),
        (
            [{"object1": {"id": 1}, "object2": MUG, "object_relation": "a on b"}],
            "is damaged or of another format",
        ),
    ],
)
def test_damaged_scenes_are_refused_in_one_line(tmp_path, document, message):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        with pytest.raises(UserError, match=message) as error:
            read_graph(save(tmp_path, document))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "document",
    [
        {"init_graph": home()},
        {"graph": home(), "success": True},
        home(edges=[], links=[{"source": 1, "target": 2, "type": "ON"}]),
        home(directed=False),
    ],
)
def test_scenes_inside_a_document_or_with_other_keys_of_edges(tmp_path, document):
    stated = facts(save(tmp_path, document))
    assert ("mug_1", "ON", "table_2") in stated


def test_nodes_of_one_label_are_individuals(tmp_path, capsys):
    nodes = [
        {"id": 0, "label": "mug"},
        {"id": 1, "label": "mug"},
        {"id": 2, "label": "table"},
    ]
    links = [{"source": 0, "target": 2, "relation": "on"}]
    path = save(tmp_path, {"nodes": nodes, "links": links})
    with pytest.warns(DataWarning, match="several nodes have one label.*: mug"):
        graph = read_graph(path)
    assert ("0", RDF_TYPE, "mug") in graph
    assert answers(capsys, path, "on table") == {"mug"}


KNOWROB = """<?xml version="1.0"?>
<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"
  xmlns:rdfs="http://www.w3.org/2000/01/rdf-schema#" xmlns:owl="http://www.w3.org/2002/07/owl#"
  xmlns:k="http://knowrob.org/kb/knowrob.owl#">
  <owl:Class rdf:about="http://knowrob.org/kb/knowrob.owl#Mug">
    <rdfs:subClassOf rdf:resource="http://knowrob.org/kb/knowrob.owl#Tableware"/>
  </owl:Class>
  <owl:NamedIndividual rdf:about="http://knowrob.org/kb/home.owl#Mug_5ZtPKs">
    <rdf:type rdf:resource="http://knowrob.org/kb/knowrob.owl#Mug"/>
    <k:heightOfObject rdf:datatype="http://www.w3.org/2001/XMLSchema#double">0.1</k:heightOfObject>
    <k:storagePlaceFor rdf:resource="http://knowrob.org/kb/home.owl#Drawer13"/>
  </owl:NamedIndividual>
  <owl:NamedIndividual rdf:about="http://knowrob.org/kb/home.owl#Bowl_abcd1234">
    <k:heightOfObject rdf:datatype="http://www.w3.org/2001/XMLSchema#double">0.05</k:heightOfObject>
  </owl:NamedIndividual>
</rdf:RDF>"""


def test_individuals_of_knowrob(tmp_path, capsys):
    path = tmp_path / "home.owl"
    path.write_text(KNOWROB)
    assert answers(capsys, path, "heightOfObject < 0.2") == {"mug", "bowl"}
    assert answers(capsys, path, "heightOfObject > 0.07") == {"mug"}
    assert answers(capsys, path, "is tableware") == {"mug"}
    assert answers(capsys, path, "storagePlaceFor drawer13") == {"mug"}
    assert answers(capsys, path, "storagePlaceFor drawer") == {"mug"}


SCAN = {
    "scan": "a",
    "objects": {"1": "mug", "2": "table", "7": "mug", "9": "book"},
    "relationships": [
        [1, 2, 15, "standing on"],
        [7, 2, 15, "standing on"],
        [9, 1, 2, "left"],
    ],
}
LISTED = {
    "objects": ["mug", "table", "book"],
    "relationships": [[0, "on", 1], [2, "on", 1]],
}


@pytest.mark.parametrize(
    ("document", "expected"),
    [
        (SCAN, {("mug_1", "standing on", "table_2"), ("mug_7", "standing on", "table_2"),
                ("book_9", "left", "mug_1")}),
        ({"scans": [SCAN], "neighbors": {}}, {("mug_7", "standing on", "table_2")}),
        (LISTED, {("mug_0", "on", "table_1"), ("book_2", "on", "table_1")}),
        ([LISTED], {("book_2", "on", "table_1")}),
    ],
)  # fmt: skip
def test_objects_named_by_their_classes_alone(tmp_path, document, expected):
    path = save(tmp_path, document)
    read = facts(path)
    assert expected <= read
    assert ("mug_0" in {head for head, _, _ in read}) == ("scan" not in str(document))
    assert {tail for _, relation, tail in read if relation == "type"} == {
        "mug",
        "table",
        "book",
    }


def test_things_of_3dssg_are_asked(tmp_path, capsys):
    assert answers(capsys, save(tmp_path, SCAN), "standing on the table") == {"mug"}


def test_one_of_several_scenes_has_to_be_saved(tmp_path):
    with pytest.raises(UserError, match="holds 2 scenes, each with objects of its own"):
        read_graph(save(tmp_path, {"scans": [SCAN, SCAN]}))
    with pytest.raises(UserError, match="holds 3 scenes"):
        read_graph(save(tmp_path, [LISTED] * 3))
