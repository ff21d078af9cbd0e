"""JSON as other programs write it, and formats that are refused by name."""

import json
import re
import shlex
import sqlite3
import subprocess
import sys
from pathlib import Path

import networkx
import pytest
import rdflib

from knowarm.errors import DataWarning, UserError
from knowarm.knowledge import graph_of, read_graph
from knowarm.knowledge.formats import write_graph
from knowarm.knowledge.formats.others import OTHERS
from knowarm.knowledge.graph.terms import RDF_TYPE, RDFS, literal

MUG, BOTTLE = ("mug", "usedFor", "drinking"), ("bottle", "usedFor", "drinking")
BOTH = (MUG, BOTTLE)
KEYS = ("head", "relation", "tail")
E = "http://e.org/"


def dumped(values):
    return "".join(json.dumps(value) + "\n" for value in values)


def keyed(triple, keys=KEYS):
    return dict(zip(keys, triple, strict=True))


def write(path, content):
    path.write_text(content, "utf-8")
    return path


LINES = {
    "lists": dumped(BOTH),
    "objects": dumped(map(keyed, BOTH)),
    "subject, predicate, object": dumped(
        keyed(triple, ("subject", "predicate", "object")) for triple in BOTH
    ),
    "numbered": dumped({"id": i, **keyed(t)} for i, t in enumerate(BOTH)),
    "without the last line end": dumped(BOTH).strip(),
    "windows": dumped(BOTH).replace("\n", "\r\n"),
    "blank lines": "\n" + dumped(BOTH).replace("\n", "\n\n"),
    "commas": ",\n".join(map(json.dumps, BOTH)),
    "indented": "\n".join(json.dumps(keyed(triple), indent=2) for triple in BOTH),
    "one list": json.dumps(BOTH),
}


@pytest.mark.filterwarnings("error::knowarm.errors.DataWarning")
@pytest.mark.parametrize(
    "name", ["a.jsonl", "a.ndjson", "a.json", "a.txt", "a.jsonl.gz"]
)
@pytest.mark.parametrize("text", LINES.values(), ids=LINES)
def test_a_value_per_line(tmp_path, text, name):
    path = write(tmp_path / name.removesuffix(".gz"), text)
    if name.endswith(".gz"):
        subprocess.run(["gzip", path], check=True)
    assert set(read_graph(tmp_path / name)) == set(BOTH)


@pytest.mark.parametrize("value", [list(MUG), keyed(MUG), keyed(MUG, ("h", "r", "t"))])
def test_a_file_of_one_line(tmp_path, value):
    assert list(read_graph(write(tmp_path / "a.jsonl", json.dumps(value)))) == [MUG]


def node(key, name, kind):
    return {"type": "node", "id": key, "labels": [kind], "properties": {"name": name}}


def neo4j_end(key, kind):
    return {"id": key, "labels": [kind]}


NODES = [node("0", "mug", "Object"), node("1", "drinking", "Use")]
RELATIONSHIP = {"id": "7", "type": "relationship", "label": "USED_FOR",
                "start": neo4j_end("0", "Object"), "end": neo4j_end("1", "Use")}  # fmt: skip
APOC = {
    "a.json": dumped([*NODES, RELATIONSHIP]),
    "b.json": json.dumps([*NODES, RELATIONSHIP]),
    "c.json": json.dumps({"nodes": NODES, "rels": [RELATIONSHIP]}),
    "d.json": dumped([RELATIONSHIP | {"start": NODES[0], "end": NODES[1]}]),
    "a.csv": '"_id","_labels","name","_start","_end","_type"\n"0",":Object","mug",,,\n'
             '"1",":Use","drinking",,,\n,,,"0","1","USED_FOR"\n',
    "b.csv": '_id;_labels;name;_start;_end;_type\n0;:Object;mug;;;\n1;:Use;drinking;;;\n'
             ';;;0;1;USED_FOR\n',
}  # fmt: skip


@pytest.mark.filterwarnings("error::knowarm.errors.DataWarning")
@pytest.mark.parametrize("name", APOC)
def test_what_neo4j_exports(tmp_path, name):
    """Case 09 and 10."""
    graph = read_graph(write(tmp_path / name, APOC[name]))
    assert set(graph) == {
        ("0", "USED_FOR", "1"),
        ("0", RDF_TYPE, "Object"),
        ("1", RDF_TYPE, "Use"),
    }
    assert graph.labels == {"0": "mug", "1": "drinking"}


def test_properties_of_neo4j_are_left_out_with_a_line(tmp_path):
    records = [
        {**NODES[0], "properties": {"name": "mug", "weight": 3}},
        NODES[1],
        RELATIONSHIP,
    ]
    with pytest.warns(DataWarning, match="not read: weight"):
        read_graph(write(tmp_path / "a.jsonl", dumped(records)))
    with pytest.warns(DataWarning, match="not read: price"):
        read_graph(
            write(tmp_path / "a.csv", APOC["a.csv"].replace('"name"', '"price"'))
        )


@pytest.mark.parametrize(("row", "message"), [
    (",,,0,1\n", "line 3: has 5 columns"),
    (",,,,,\n,,,,1,ON\n", "line 4: is neither a node .* nor a relationship with _start, .*1, ON"),
    (",x,,,,\n", "line 3: is neither a node"),
])  # fmt: skip
def test_a_broken_export_of_neo4j_is_refused(tmp_path, row, message):
    text = "_id,_labels,name,_start,_end,_type\n0,:A,mug,,,\n"
    with pytest.raises(UserError, match=message):
        read_graph(write(tmp_path / "a.csv", text + row))


def concept(name, language="en"):
    key = f"/c/{language}/{name}"
    return {
        "@id": key,
        "@type": "Node",
        "label": name,
        "language": language,
        "term": key,
    }


def edge(start, end, weight=2.0, relation="UsedFor"):
    key = f"/a/[/r/{relation}/,{start['@id']}/,{end['@id']}/]"
    rel = {"@id": f"/r/{relation}", "@type": "Relation", "label": relation}
    return {
        "@id": key,
        "@type": "Edge",
        "start": start,
        "end": end,
        "rel": rel,
        "weight": weight,
    }


def api(edges, **more):
    return json.dumps({"@context": ["http://api.conceptnet.io/ld/conceptnet5.7/context.ld.json"],
                       "@id": "/c/en/mug", "edges": edges, **more})  # fmt: skip


def test_answers_of_the_api_of_conceptnet(tmp_path):
    """Case 11: its context is remote, and it is read without."""
    edges = [
        edge(concept("mug"), concept("drinking")),
        edge(concept("mug/n"), concept("hot_tea")),
    ]
    graph = read_graph(write(tmp_path / "a.json", api(edges)))
    assert set(graph) == {("mug", "UsedFor", "drinking"), ("mug", "UsedFor", "hot_tea")}
    edges += [
        edge(concept("tasse", "de"), concept("mug")),
        edge(concept("mug"), concept("face"), 0.5),
    ]
    left_out = (
        "1 edges .* not English; 1 edges of a weight below 1; .* next page, /c/en/mug"
    )
    path = write(
        tmp_path / "a.json", api(edges, view={"nextPage": "/c/en/mug?offset=20"})
    )
    with pytest.warns(DataWarning, match=left_out):
        assert read_graph(path) == graph
    ends = {"start": "/c/en/mug", "rel": "/r/IsA", "end": "/c/en/cup"}
    assert list(
        read_graph(write(tmp_path / "a.json", json.dumps({"edges": [ends]})))
    ) == [("mug", "IsA", "cup")]


def rdflib_graph():
    graph = rdflib.Graph()
    mug = rdflib.URIRef(E + "mug")
    graph.add((mug, rdflib.URIRef(E + "usedFor"), rdflib.URIRef(E + "drinking")))
    graph.add((mug, rdflib.URIRef(E + "price"), rdflib.Literal(5)))
    graph.add((mug, rdflib.URIRef(E + "note"), rdflib.Literal("für Tee", lang="de")))
    graph.add((mug, rdflib.URIRef(E + "note"), rdflib.Literal("old")))
    graph.add((mug, rdflib.RDFS.label, rdflib.Literal("Becher", lang="de")))
    return graph


@pytest.mark.parametrize("name", ["a.hext", "a.ndjson", "a.jsonl"])
def test_hextuples_are_what_rdflib_writes(tmp_path, name):
    rdflib_graph().serialize(tmp_path / "a.nt", format="nt")
    rdflib_graph().serialize(tmp_path / name, format="hext")
    assert read_graph(tmp_path / name) == read_graph(tmp_path / "a.nt")


@pytest.mark.parametrize("variables", ["?s ?p ?o", "?subject ?predicate ?object"])
@pytest.mark.parametrize("name", ["a.json", "a.srj"])
def test_answers_of_sparql_whose_variables_are_a_triple(tmp_path, name, variables):
    rdflib_graph().serialize(tmp_path / "a.nt", format="nt")
    query = f"SELECT {variables} WHERE {{ {variables} }}"
    rdflib_graph().query(query).serialize(str(tmp_path / name), format="json")
    assert read_graph(tmp_path / name) == read_graph(tmp_path / "a.nt")


@pytest.mark.parametrize("query", [
    "SELECT ?item ?label WHERE { ?item rdfs:label ?label }",
    "SELECT ?item ?itemLabel ?x WHERE { ?item rdfs:label ?itemLabel ; ?p ?x }",
    "ASK { ?a ?b ?c }",
])  # fmt: skip
def test_other_answers_of_sparql_are_refused(tmp_path, query):
    rdflib_graph().query(query).serialize(str(tmp_path / "a.json"), format="json")
    with pytest.raises(
        UserError, match=r"answers of a SPARQL query, .*SELECT \?s \?p \?o"
    ):
        read_graph(tmp_path / "a.json")


def test_rdf_json(tmp_path):
    about = {
        E + "usedFor": [{"type": "uri", "value": E + "drinking"}],
        E + "price": [{"type": "literal", "value": "5", "datatype": "http://a.org/x"}],
        E + "on": [{"type": "bnode", "value": "_:x"}],
        RDFS + "label": [{"type": "literal", "value": "Becher", "lang": "de"}],
    }
    below = {E + "in": [{"type": "uri", "value": E + "hall"}]}
    document = {E + "mug": about, "_:x": below}
    graph = read_graph(write(tmp_path / "a.rj", json.dumps(document)))
    assert set(graph) == {
        (E + "mug", E + "on", "_:x"),
        ("_:x", E + "in", E + "hall"),
        (E + "mug", E + "usedFor", E + "drinking"),
        (E + "mug", E + "price", literal("5", datatype="http://a.org/x")),
    }
    assert graph.labels == {E + "mug": "Becher"}


def test_values_of_nodes_are_left_out_with_a_line(tmp_path):
    node = {"id": "mug", "label": "mug", "size": 3, "type": "Dish"}
    links = [{"head": "mug", "relation": "on", "tail": "table"}]
    document = json.dumps({"nodes": [node], "links": links})
    with pytest.warns(DataWarning, match="not read: size, type"):
        graph = read_graph(write(tmp_path / "a.json", document))
    assert list(graph) == [("mug", "on", "table")]


def test_graphs_of_other_programs(tmp_path):
    cytoscape = {"elements": {
        "nodes": [{"data": {"id": "0", "name": "mug"}}, {"data": {"id": "1", "name": "drinking"}}],
        "edges": [{"data": {"source": "0", "target": "1", "interaction": "usedFor", "name": "x"}}],
    }}  # fmt: skip
    with pytest.warns(DataWarning, match="not read: name"):
        graph = read_graph(write(tmp_path / "a.json", json.dumps(cytoscape)))
    assert list(graph) == [("0", "usedFor", "1")]
    nodes = {"0": {"label": "mug"}, "1": {"label": "drinking"}}
    edges = [{"source": "0", "target": "1", "relation": "usedFor"}]
    document = {"graph": {"directed": True, "nodes": nodes, "edges": edges}}
    assert read_graph(write(tmp_path / "a.json", json.dumps(document))) == graph
    obo = {"graphs": [{
        "nodes": [{"id": E + "mug", "lbl": "mug"}, {"id": E + "cup", "lbl": "cup", "meta": {}},
                  {"id": E + "mug2", "lbl": "mug"}, {"id": E + "none"}],
        "edges": [{"sub": E + "mug", "pred": "is_a", "obj": E + "cup"}],
    }]}  # fmt: skip
    with pytest.warns(DataWarning, match="not read: meta"):
        graph = read_graph(write(tmp_path / "a.json", json.dumps(obo)))
    assert list(graph) == [(E + "mug", RDFS + "subClassOf", E + "cup")]
    assert graph.labels == {E + "mug": "mug", E + "cup": "cup", E + "mug2": "mug"}
    assert E + "none" in graph.entities


@pytest.mark.parametrize("version", ['Creator "yFiles"\nVersion "2.2"\n', ""])
def test_gml(tmp_path, version):
    network = networkx.MultiDiGraph()
    for key, label in enumerate(["mug", "mug", "table"]):
        network.add_node(str(key), name=label)
    network.add_edge("0", "2", relation="on")
    network.add_edge("1", "2", relation="under")
    networkx.write_gml(network, tmp_path / "a.gml")
    text = version + (tmp_path / "a.gml").read_text().replace(
        "multigraph 1\n", "multigraph 1\n"
    )
    for name in ("a.gml", "a.txt"):
        graph = read_graph(write(tmp_path / name, text))
        assert len(graph) == 2
        assert {relation for _, relation, _ in graph} == {"on", "under"}
    undirected = text.replace("directed 1", "directed 0")
    with pytest.raises(UserError, match="edges without a direction"):
        read_graph(write(tmp_path / "a.gml", undirected))


REFUSED = {
    "lists of four": (
        json.dumps([["mug", "on", "table", 0.3], ["mug", "in", "hall", 1]]),
        "is no link with the names of a head, a relation and a tail",
    ),
    "a list of four behind one of three": (
        json.dumps([["mug", "on", "table"], ["mug", "in", "hall", "no"]]),
        "write lists of three",
    ),
    "a cut answer": (
        json.dumps({"head": {"vars": ["s", "p", "o"]}, "results": {}}),
        "'bindings'",
    ),
    "a cut export": (json.dumps(RELATIONSHIP | {"end": None}), "of another format"),
    "a concept without a name": (
        api([edge(concept("mug"), {"@id": ""})])[:-1] + "]",
        "line 1",
    ),
    "lists of six": (dumped([["a", 2, 3, 4, 5, 6]]), "of another format"),
    "a cut line": (
        dumped(BOTH) + '["mug", "usedFor"\n',
        "line 3: not well-formed JSON",
    ),
    "prose": (dumped(BOTH) + "I hope this helps!\n", "line 3: not well-formed JSON"),
    "two cells": (
        dumped([["mug", "drinking"], ["can", "pouring"]]),
        "is no link with the names",
    ),
    "wide objects": (
        dumped([{"object": "mug", "affordance": "drinking", "material": "clay"}] * 2),
        "is no link with the names",
    ),
    "hasPartKB": (
        dumped(
            [
                {
                    "arg1": {"normalized": "mug"},
                    "arg2": {"normalized": "ear"},
                    "score": 0.9,
                }
            ]
            * 2
        ),
        "none of arg1, arg2, score names the relation",
    ),
    "wikidata": (
        dumped([{"id": "Q1", "labels": {}, "claims": {}}] * 2),
        "entities of Wikidata as JSON. Download them as Turtle",
    ),
    "wikidata's API": (
        json.dumps({"entities": {"Q1": {"id": "Q1", "labels": {}, "claims": {}}}}),
        "entities of Wikidata as JSON",
    ),
}


@pytest.mark.parametrize(("text", "message"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_graph_is_refused_in_one_line(tmp_path, text, message):
    with pytest.raises(UserError, match=message) as error:
        read_graph(write(tmp_path / "a.jsonl", text))
    assert "\n" not in str(error.value)


def typed(message, folder):
    """Run the command that a message ends with."""
    command = re.search(r": ((?:python|tr|sqlite3) .*)$", message)[1]
    command = command.replace("python -c", f"{shlex.quote(sys.executable)} -c", 1)
    subprocess.run(command, shell=True, check=True, cwd=folder)


BY_NAME = {
    "relations": ({"mug": {"on": "desk", "usedFor": ["tea", "milk"]},
                   "pan": {"weight": 2, "x": None}},
                  {("mug", "on", "desk"), ("mug", "usedFor", "tea"), ("mug", "usedFor", "milk"),
                   ("pan", "weight", "2")}),
    "words": ({"mug": ["GRABBABLE", "MOVABLE"], "pan": ["GRABBABLE"]},
              {("mug", "hasProperty", "GRABBABLE"), ("mug", "hasProperty", "MOVABLE"),
               ("pan", "hasProperty", "GRABBABLE")}),
    "objects": ({"mug": {"breakable": {}, "fillable": {"a": 1}}, "pan": {}},
                {("mug", "hasProperty", "breakable"), ("mug", "hasProperty", "fillable")}),
}  # fmt: skip


@pytest.mark.parametrize("name", ["a.json", "it's 1.json"])
@pytest.mark.parametrize(("value", "triples"), BY_NAME.values(), ids=BY_NAME)
def test_the_remedy_for_properties_by_name_works_when_it_is_typed(
    tmp_path, monkeypatch, value, triples, name
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match="neither JSON-LD nor a graph") as refused:
        read_graph(write(Path(name), json.dumps(value)))
    typed(str(refused.value), tmp_path)
    assert set(read_graph(Path("triples.json"))) == triples


def test_formats_that_are_not_read_are_named(tmp_path):
    for name, other in OTHERS.items():
        for suffix in other.suffixes:
            path = tmp_path / f"a{suffix}"
            path.write_bytes(b"x")
            with pytest.raises(UserError, match=f"{name} is not read") as error:
                read_graph(path)
            assert "\n" not in str(error.value)


@pytest.mark.parametrize(("name", "text"), [
    ("Cypher", 'CREATE (m:Object {name: "mug"})-[:USED_FOR]->(d:Use {name: "drinking"});\n'),
    ("Cypher", 'MERGE (m:Object {name: "mug"});\nMATCH (a),(b) CREATE (a)-[:X]->(b);\n'),
    ("Cypher", ":begin\nCREATE CONSTRAINT ON (node:`U`) ASSERT (node.`I`) IS UNIQUE;\n"),
    ("Prolog", "usedFor(mug, drinking).\ncontains(bottle, water).\n"),
    ("Prolog", ":- dynamic usedFor/2.\nusedFor(mug, drinking).\n"),
    ("Prolog", "usedFor(mug, drinking)\ncontains(bottle, water)\n"),
    ("YAML", "---\nmug:\n  usedFor: drinking\n"),
    ("TriX", '<?xml version="1.0"?>\n<TriX xmlns="http://www.w3.org/2004/03/trix/trix-1/"/>'),
    ("XML of SPARQL answers", '<sparql xmlns="http://www.w3.org/2005/sparql-results#"/>'),
    ("HDT", "$HDT\x01"),
    ("DOT of Graphviz", 'digraph g {\n mug -> drinking [label="usedFor"];\n}\n'),
])  # fmt: skip
@pytest.mark.parametrize("suffix", [".txt", ".xml", ".graph"])
def test_formats_that_are_not_read_are_known_by_their_content(
    tmp_path, name, text, suffix
):
    with pytest.raises(UserError, match=f"{name} is not read"):
        read_graph(write(tmp_path / f"a{suffix}", text))


def convert(path, content, made):
    """Write a file, run the command of its refusal, and read what that made."""
    if content is not None:
        path.write_text(content)
    with pytest.raises(UserError, match="is not read") as refused:
        read_graph(path)
    typed(str(refused.value), Path.cwd())
    return read_graph(made)


def test_the_commands_for_formats_that_are_not_read_work_when_they_are_typed(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    write_graph(graph_of(BOTH), Path("both.nt"))
    dataset = rdflib.Dataset()
    dataset.parse("both.nt", format="nt")
    dataset.serialize("my file.trix", format="trix")
    assert set(convert(Path("my file.trix"), None, Path("my file.trix.nq"))) == set(
        BOTH
    )
    prolog = ":- dynamic p/2.\nusedFor(mug, drinking).\nusedFor( 'bottle' ,drinking). % yes\n"
    for name in ("a b.pl", "facts.txt"):
        assert set(convert(Path(name), prolog, Path(name).with_suffix(".csv"))) == set(
            BOTH
        )
    yaml = "".join(f"- {{head: {h}, relation: {r}, tail: {t}}}\n" for h, r, t in BOTH)
    assert set(convert(Path("it's.yaml"), yaml, Path("it's.yaml.json"))) == set(BOTH)
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    columns = dict(zip(KEYS, map(list, zip(*BOTH, strict=True)), strict=True))
    parquet.write_table(pyarrow.table(columns), "a.parquet")
    assert set(convert(Path("a.parquet"), None, Path("a.parquet.csv"))) == set(BOTH)


def test_the_command_for_sqlite(tmp_path, monkeypatch):
    if subprocess.run(["which", "sqlite3"], capture_output=True).returncode:
        pytest.skip("needs sqlite3")
    monkeypatch.chdir(tmp_path)
    with sqlite3.connect("a.db") as database:
        database.execute("CREATE TABLE triples (head, relation, tail)")
        database.executemany("INSERT INTO triples VALUES (?, ?, ?)", BOTH)
    assert set(convert(Path("a.db"), None, Path("a.csv"))) == set(BOTH)
