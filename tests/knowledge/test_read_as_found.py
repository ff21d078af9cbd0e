"""Graphs as other programs and people write them: read right, or refused or warned in one line."""

import csv
import gzip
import io
import json
import re
import shlex
import subprocess
import sys
import warnings
from importlib import metadata
from pathlib import Path

import hypothesis.strategies as st
import networkx
import pyhornedowl
import pytest
import rdflib
from hypothesis import given, settings

from knowarm.errors import DataWarning, UserError
from knowarm.knowledge import graph_of, read_graph
from knowarm.knowledge.formats import write_graph
from knowarm.knowledge.formats.splits import read_parts
from knowarm.knowledge.graph.builder import union
from knowarm.knowledge.graph.edits import edited
from knowarm.knowledge.graph.terms import (
    iri_of_name,
    literal,
    local_name,
    parse_literal,
)
from knowarm.knowledge.queries.sparql import SparqlQuery
from tests.thorough import thorough

pytestmark = pytest.mark.usefixtures("unfenced")

MUG, BOTTLE = ("mug", "usedFor", "drinking"), ("bottle", "usedFor", "drinking")
CUP = ("mug", "isA", "cup")
E = "http://e.org/"
E_MUG = (E + "mug", E + "usedFor", E + "drinking")
TURTLE = "@prefix : <urn:knowarm:> .\n:mug :usedFor :drinking .\n"
XML = """<?xml version="1.0" encoding="ISO-8859-1"?>
<!DOCTYPE rdf:RDF [ <!ENTITY e 'http://e.org/'> ]>
<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" xmlns:k="http://e.org/">
<rdf:Description rdf:about="&e;mug"><k:usedFor rdf:resource="&e;drinking"/><k:note>Köln:
Prefix(:=&lt;http://e.org/&gt;)
</k:note></rdf:Description></rdf:RDF>"""
GRAPHML = """<?xml version="1.0"?><!-- yEd --><graphml xmlns="http://graphml.graphdrawing.org/xmlns">
<key id="d0" for="edge" attr.name="label"/><key id="d1" for="node" attr.name="label"/>
<graph edgedefault="directed"><node id="n0"><data key="d1">Mug</data></node><node id="n1"/>
<edge source="n0" target="n1"><data key="d0">usedFor</data></edge></graph></graphml>"""
NODES = [{"id": "mug"}, {"id": "bottle"}, {"id": "drinking"}]
LINKS = [
    {"source": each, "target": "drinking", "relation": "usedFor"}
    for each in ("mug", "bottle")
]

READ = [
    # tables: blanks, letters, quotes, separators, encodings, other headers and columns
    ("a.csv", "head, relation, tail\nmug , usedFor , drinking \nbottle, usedFor, drinking\n"),
    ("a.csv", "mug\xa0,used\u0046or,drinking\nbottle,usedFor,drinking\n"),
    ("a.csv", "source,relation,target\nmug,usedFor,drinking\nbottle,usedFor,drinking\n"),
    ("a.csv", "source,target,type\nmug,drinking,usedFor\nbottle,drinking,usedFor\n"),
    ("a.csv", "subject,relation,object\nmug,usedFor,drinking\nbottle,usedFor,drinking\n"),
    ("a.csv", ":START_ID,:END_ID,:TYPE\nmug,drinking,usedFor\nbottle,drinking,usedFor\n"),
    ("a.csv", "a:START_ID(X),:TYPE,:END_ID(X)\nmug,usedFor,drinking\nbottle,usedFor,drinking\n"),
    ("a.csv", "mug,usedFor,drinking,,\nbottle,usedFor,drinking,,\n,,,,\n"),
    ("a.csv", "\ufeffhead;relation;tail\r\nmug;usedFor;drinking\r\nbottle;usedFor;drinking\r\n"),
    ("a.csv", "mug\tusedFor\tdrinking\nbottle\tusedFor\tdrinking\n"),
    ("a.tsv", "mug,usedFor,drinking\nbottle,usedFor,drinking\n"),
    ("a.tsv", '"mug"\t"usedFor"\t"drinking"\nbottle\tusedFor\tdrinking\n'),
    ("a.tsv", "#head\trelation\ttail\nmug\tusedFor\tdrinking\nbottle\tusedFor\tdrinking\n"),
    ("a.txt", "node1\tlabel\tnode2\nmug\tusedFor\tdrinking\nbottle\tusedFor\tdrinking\n"),
    ("a.csv", "mug,usedFor,drinking\nbottle,usedFor,drinking\n".encode("utf-16")),
    # documents
    ("a.json", json.dumps({"directed": True, "nodes": NODES, "links": LINKS})),
    ("a.json", json.dumps({"nodes": NODES, "edges": LINKS})),
    ("a.json", json.dumps([list(MUG), list(BOTTLE)])),
    ("a.json", json.dumps([dict(zip("hrt", each, strict=True)) for each in (MUG, BOTTLE)])),
    ("a.json", '{"nodes": [{"id": "mug"}, {"id": "bottle"}, {"id": "drinking"}], "links": ['
               '{"source": 0, "target": 2, "type": "usedFor"},'
               ' {"source": 1, "target": 2, "type": "usedFor"}]}'),
    ("a.jsonld", json.dumps([list(MUG), list(BOTTLE)])),
    ("a.tsv", json.dumps([list(MUG), list(BOTTLE)])),
    # RDF under another suffix
    ("a.owl", TURTLE + ":bottle :usedFor :drinking ."),
    ("a.txt", "# nt\n<urn:knowarm:mug> <urn:knowarm:usedFor> <urn:knowarm:drinking> .\n"
              "<urn:knowarm:bottle> <urn:knowarm:usedFor> <urn:knowarm:drinking> ."),
    ("a.nq", "<urn:knowarm:mug> <urn:knowarm:usedFor> <urn:knowarm:drinking> <urn:g> .\n"
             "<urn:knowarm:bottle> <urn:knowarm:usedFor> <urn:knowarm:drinking> .\n"),
    ("a.trig", "@prefix : <urn:knowarm:> .\n:g { :mug :usedFor :drinking }\n"
               "{ :bottle :usedFor :drinking . }"),
    ("a.n3", TURTLE + ":bottle :usedFor :drinking ."),
]  # fmt: skip


def write(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(("name", "content"), READ)
def test_what_people_have_is_read_right_and_without_a_warning(tmp_path, name, content):
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataWarning)
        assert set(read_graph(write(tmp_path / name, content))) == {MUG, BOTTLE}


@pytest.mark.parametrize(
    ("name", "content", "triples", "warning"),
    [
        ("a.csv", "head,relation,tail,w\nmug,usedFor,drinking,1.0\n", {MUG}, "not read: w"),
        ("a.tsv", "id\tnode1\tlabel\tnode2\n1\tmug\tusedFor\tdrinking\n", {MUG}, "not read: id"),
        ("a.json", '[{"s": "mug", "p": "usedFor", "o": "drinking", "weight": 2}]', {MUG}, "weight"),
        ("a.ttl", TURTLE + ":mug :recipe <http://e.org/hot chocolate> .", {MUG}, "line 3: Invalid"),
        ("a.ttl", TURTLE + "foaf:x :y :z .", {MUG}, "1 malformed .* line 3: The prefix f"),
        ("a.ttl", TURTLE[:-2] + "{| :source :me |} .", {MUG}, "1 statements about triples"),
        (
            "a.nt",
            "<urn:knowarm:mug> <urn:knowarm:usedFor> <urn:knowarm:drinking> .\n<urn:a> <urn:b>\n",
            {MUG},
            "in line 3: line jumps",
        ),
        (
            "a.csv",
            "Kram,Link,Other\nmug,usedFor,drinking\nbottle,usedFor,drinking\n"
            "mug,isA,cup\nbottle,isA,cup\n",
            {MUG, BOTTLE, CUP, ("bottle", "isA", "cup"), ("Kram", "Link", "Other")},
            "line 1: Kram, Link, Other was read as a triple, but no word of it occurs again",
        ),
    ],
)  # fmt: skip
def test_what_is_left_out_or_doubtful_is_said_in_one_line(
    tmp_path, name, content, triples, warning
):
    with pytest.warns(DataWarning, match=warning) as caught:
        graph = read_graph(write(tmp_path / name, content))
    assert set(graph) == triples
    assert [str(each.message).count("\n") for each in caught] == [0]


def run_remedy(message, folder):
    """Run the command that a message ends with, and return what it printed."""
    command = re.search(r"(?:: |^)((?:python|tr|iconv) .*?)\.?$", message)[1]
    command = command.replace("python -c", f"{shlex.quote(sys.executable)} -c", 1)
    return subprocess.run(
        command, shell=True, check=True, cwd=folder, capture_output=True, text=True
    ).stdout


THINGS = "mug,drinking,clay\nbowl,eating,clay\n"
WIDE = {
    "commas": ("a.csv", f"object,affordance,material\n{THINGS}", 4),
    "case 04": ("a.csv", "object,affordance,material\nmug,drinking,ceramic\nbowl,eating,ceramic\n"
                "bottle,pouring,glass\nkettle,boiling,steel\n", 8),
    "tabs": ("a.tsv", "name\taffordance\tmaterial\nmug\tdrinking\tclay\nbowl\tx\tclay\n", 4),
    "semicolons": ("a.csv", f"Item;affordance;material\n{THINGS}".replace(",", ";"), 4),
    "excel": ("a.csv", "sep=;\n" + f"Items,affordance,material\n{THINGS}".replace(",", ";"), 4),
    "no first name": ("a.csv", f",affordance,material\n{THINGS}", 4),
    "quotes": ("a.csv", '"","affordance","the ""material"""\n"mug","drinking","a, b"\n', 2),
    "after blanks": ("a.csv", 'thing, affordance, of\nmug, drinking, "a, b"\nb, c, d\n', 4),
    "utf-16": ("a.csv", f",affordance,material\n{THINGS}".encode("utf-16"), 4),
    "a mark": ("a.csv", "\ufeffname,affordance,material\nmug,drinking,é\nbowl,eating,clay\n", 4),
    "a path with blanks": ("a folder/it's my $HOME.csv", f"id,affordance,material\n{THINGS}", 4),
    "four columns": ("a.csv", "object,affordance,material,weight\nmug,drinking,,1\n", 2),
    "capitals": ("a.csv", "Objects,affordance,weight\nmug,drinking,1\nbowl,eating,0\n", 4),
    "seven": ("a.csv", "cosa,affordance,b,c,d,e,f\nmug,drinking,,1,0,x,y\ncan,0,a,,1,x,z\n", 10),
    "an identifier": ("a.csv", "thingId,affordance,colour\nmug,drinking,red\nb,Bowls hold.,1\n", 4),
    "blank cells": ("a.csv", 'id,affordance,of\nmug,drinking,"\xa0 "\nb," ",d\n', 2),
    "two columns": ("a.csv", "Object,affordance\nmug,drinking\nmug,pouring\n", 2),
    "gzip": ("a.csv.gz", gzip.compress(f"name,affordance,material\n{THINGS}".encode()), 4),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "libraries"),
    [("a.csv", "pandas"), ("a.xlsx", "pandas openpyxl"), ("a.yaml", "pyyaml")],
)
def test_a_remedy_installs_the_libraries_that_are_not_there(
    tmp_path, monkeypatch, name, libraries
):
    def refuse(library):
        raise metadata.PackageNotFoundError(library)

    path = tmp_path / name
    path.write_text(WIDE["commas"][1])
    monkeypatch.setattr(metadata, "distribution", refuse)
    with pytest.raises(UserError, match=f": pip install {libraries} && python -c"):
        read_graph(path)


@pytest.mark.parametrize(("name", "content", "count"), WIDE.values(), ids=WIDE)
def test_the_remedy_for_a_column_per_property_works_when_it_is_typed(
    tmp_path, monkeypatch, name, content, count
):
    pandas = pytest.importorskip("pandas")
    monkeypatch.chdir(tmp_path)
    Path("a folder").mkdir()
    file = write(Path(name), content)
    with pytest.raises(UserError, match="a line per property: python") as refused:
        read_graph(file)
    assert "\n" not in str(refused.value)
    run_remedy(str(refused.value), tmp_path)
    graph = read_graph(Path("triples.csv"))
    assert ("mug", "affordance", "drinking") in graph
    table = pandas.read_csv("triples.csv", dtype=str)
    assert set(table.itertuples(index=False, name=None)) == set(graph)
    assert len(graph) == count


@pytest.mark.parametrize(
    "text",
    [
        "mug,drinking,ceramic\nbowl,eating,clay\nbottle,pouring,glass\n",
        "".join(f"{i},Mug {i} is a cup that holds tea.,yes\n" for i in range(40)),
        "Ding;Zweck;Stoff\nTasse;Trinken;Ton\nSchale;Essen;Ton\n",
        "mug,red,0.3\nbowl,blue,0.3\nbottle,green,0.2\nkettle,red,1.2\n",
    ],
)
def test_columns_without_relations_are_doubted(tmp_path, text):
    with pytest.warns(DataWarning, match="were read as relations, but hardly"):
        read_graph(write(tmp_path / "a.csv", text))


@pytest.mark.parametrize(
    "text",
    [
        "4\t1\tA mug falls.\n4\t2\tIt breaks.\n5\t1\tTea boils.\n",
        "0\t1\t2\n3\t1\t4\n",
        "mug\t0.5\tcup\nmug\t-1,5\tpot\n",
    ],
)
def test_relations_that_are_numbers_are_doubted(tmp_path, text):
    with pytest.warns(DataWarning, match="read as relations, .* or they are numbers"):
        read_graph(write(tmp_path / "a.tsv", text))


@pytest.mark.filterwarnings("error::knowarm.errors.DataWarning")
@pytest.mark.parametrize(
    "text",
    [
        "mug,usedFor,drinking\n",
        "node1,label,node2\nmug,1,drinking\npan,2,frying\n",
        "mug,usedFor,tea\nbowl,madeOf,clay\nbottle,contains,water\nkettle,hasPart,lid\n",
        "mug,on,table\nbowl,in,sink\nlamp,near,window\n",
        "mug,used for,tea\nbowl,made of,clay\nlamp,lights,room\n",
        "name,isA,word\nmug,isA,cup\n",
        "object,kind,thing\nobject,has,weight\nmug,holds,tea\n",
    ],
)
def test_small_graphs_are_not_doubted(tmp_path, text):
    rows = text.count("\n") - text.startswith("node1")
    assert len(read_graph(write(tmp_path / "a.csv", text))) == rows


@pytest.mark.parametrize(
    "text",
    ["sep=;\n{}", '"sep=;"\n{}', "SEP=;\r\n{}", "\ufeffsep=;\n{}"],
)
@pytest.mark.parametrize("name", ["a.csv", "a.tsv", "a.txt"])
@pytest.mark.filterwarnings("error::knowarm.errors.DataWarning")
def test_the_separator_that_excel_writes_first(tmp_path, name, text):
    for rows in (
        "head;relation;tail\nmug;usedFor;drinking\n",
        "mug;usedFor;drinking\n",
    ):
        path = write(tmp_path / name, text.format(rows))
        assert list(read_graph(path)) == [MUG]
    path.write_bytes("sep=\t\nmug\tusedFor\tdrinking\n".encode("utf-16"))
    assert list(read_graph(path)) == [MUG]


@pytest.mark.filterwarnings("error::knowarm.errors.DataWarning")
@pytest.mark.parametrize("header", [
    "Head Entity,Relation Type,Tail Entity", "entity_1,relation,entity_2", "node-1,edge,node-2",
    "head_name,relation_name,tail_name", "Subject ,Predicate Name, Object", "e_1,rel,e_2",
    "source node,edge type,target node", "SUBJECT_ID,PREDICATE,OBJECT_ID", "sub,pred,obj",
])  # fmt: skip
def test_names_of_columns_in_other_spellings(tmp_path, header):
    for separator in ",;\t":
        text = f"{header}\nmug,usedFor,drinking\n".replace(",", separator)
        assert list(read_graph(write(tmp_path / "a.csv", text))) == [MUG]


def test_exact_names_of_columns_go_first(tmp_path):
    text = "subject_id,subject,relation,object,object_name\n1,mug,usedFor,drinking,x\n"
    with pytest.warns(DataWarning, match="not read: object_name, subject_id"):
        assert list(read_graph(write(tmp_path / "a.csv", text))) == [MUG]


@pytest.mark.parametrize("name", ["negated", "Polarity", "truth", "is_true", "valid"])
def test_a_column_that_says_what_holds_is_refused(tmp_path, name):
    """Else a fact would be read that the file denies."""
    record = {"head": "mug", "relation": "usedFor", "tail": "eating", name: "false"}
    files = {
        "a.csv": f"{','.join(record)}\n{','.join(record.values())}\n",
        "a.md": f"| {' | '.join(record)} |\n|---|---|---|---|\n| {' | '.join(record.values())} |\n",
        "a.json": json.dumps([record]),
        "a.jsonl": json.dumps(record),
    }
    for file, text in files.items():
        with pytest.raises(UserError, match=f"{name.lower()} says which triples hold"):
            read_graph(write(tmp_path / file, text))


def test_columns_are_named_in_pairs(tmp_path):
    """A source beside an object is where a row comes from."""
    text = "object,type,source\nmug,cup,Wikipedia\nbowl,dish,Wikipedia\n"
    with pytest.raises(
        UserError, match="source names a head and object a tail, but not"
    ):
        read_graph(write(tmp_path / "a.csv", text))
    for header in (
        "cue,association,explanation,relation",
        "from_word,to_word,score,relation",
    ):
        with pytest.warns(DataWarning, match="not read"):
            assert list(
                read_graph(
                    write(tmp_path / "a.csv", f"{header}\nmug,drinking,1,usedFor\n")
                )
            ) == [MUG]
    with pytest.raises(
        UserError, match="if there is none and all state the same, add it"
    ):
        read_graph(write(tmp_path / "a.csv", "cue,response,R1\nmug,cup,2\n"))
    header = "source,subject,relation,object\nwiki,mug,usedFor,drinking\n"
    with pytest.warns(DataWarning, match="not read: source"):
        assert list(read_graph(write(tmp_path / "a.csv", header))) == [MUG]


def test_a_file_of_latin_letters_is_converted_by_the_printed_command(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for name, text in {
        "my graph.csv": "head,relation,tail\ncafé,isA,place\n",
        "a.nt": '<urn:knowarm:mug> <urn:knowarm:name> "café" .\n',
    }.items():
        file = write(Path(name), text.encode("latin-1"))
        with pytest.raises(UserError, match="not UTF-8") as refused:
            read_graph(file)
        run_remedy(str(refused.value), tmp_path)
        graph = read_graph(file.with_stem(f"{file.stem}-utf8"))
        assert any("café" in name for name in graph.entities)


@pytest.mark.filterwarnings("error::knowarm.errors.DataWarning")
@pytest.mark.parametrize(
    ("text", "said", "mistaken", "typed"),
    [
        ("Ding,Art,Wert\nmug,drinking,usedFor\nbottle,drinking,usedFor\n"
         "mug,tea,holds\nbottle,tea,holds\n", "write head,relation,tail", "Ding,Art,Wert",
         "head,tail,relation"),
        ("mug,usedFor,drinking,1\nmug,holds,tea,2\n", "name the columns in the first line, three "
         "of them head, relation and tail, such as head,relation,tail,weight", "",
         "head,relation,tail,weight\n"),
        ("source,Art,target\nmug,usedFor,drinking\nmug,holds,tea\n", "Name the relation one of "
         "relation, predicate", "Art", "relation"),
    ],
)  # fmt: skip
def test_the_remedy_for_columns_works_when_it_is_typed(
    tmp_path, text, said, mistaken, typed
):
    path = write(tmp_path / "a.csv", text)
    with pytest.raises((UserError, DataWarning), match=said):
        read_graph(path)
    write(path, text.replace(mistaken, typed, 1))
    with warnings.catch_warnings(
        action="ignore", category=DataWarning
    ):  # "weight" is not read
        assert {MUG, ("mug", "holds", "tea")} <= set(read_graph(path))


DOUBTED = {("mug", "holds", "tea"): 0.25}
WITH_CONFIDENCE = {
    "a.csv": "head,relation,tail,confidence\nmug,usedFor,drinking,\nmug,holds,tea,.25\n"
             "mug,holds,tea,.1\nmug,usedFor,drinking,.5\n",
    "a.tsv": "confidence\ttail\trelation\thead\n0.25\ttea\tholds\tmug\n1\tdrinking\tusedFor\tmug\n",
}  # fmt: skip


@pytest.mark.parametrize("name", WITH_CONFIDENCE)
def test_confidence_of_facts_is_read_kept_and_written(tmp_path, name):
    graph = read_graph(write(tmp_path / name, WITH_CONFIDENCE[name]))
    assert (set(graph), graph.confidence) == ({MUG, ("mug", "holds", "tea")}, DOUBTED)
    for kept in (edited(graph, ["+ bottle holds tea", "- mug usedFor drinking"]),
                 union(graph_of([BOTTLE]), graph), graph.with_triples(graph.triples)):  # fmt: skip
        assert kept.own_confidence() == DOUBTED
    # The other graph is certain
    assert union(graph_of(DOUBTED), graph).own_confidence() == {}
    write_graph(graph, tmp_path / "b.tsv")
    assert read_graph(tmp_path / "b.tsv") == graph
    assert read_graph(tmp_path / "b.tsv") != graph_of(graph)
    with pytest.warns(DataWarning, match="confidence of 1 triples is left out"):
        write_graph(graph, tmp_path / "b.rdf")
    for name in ("b.ttl", "b.nt"):
        with pytest.warns(DataWarning, match="readers of RDF 1.1 refuse"):
            write_graph(graph, tmp_path / name)
        assert read_graph(tmp_path / name) == graph


@pytest.mark.parametrize(
    "name", ["confidence", "Confidence", "probability", "certainty"]
)
def test_a_fact_of_confidence_zero_states_nothing(tmp_path, name):
    tables = {
        "a.csv": f"head,relation,tail,{name}\nmug,usedFor,drinking,0\nmug,holds,tea,0.25\n",
        "b.csv": f"head;relation;tail;{name}\nmug;usedFor;drinking;0,0\nmug;holds;tea;0,25\n",
        "a.json": json.dumps([{"h": "mug", "r": "usedFor", "t": "drinking", name: 0},
                              {"h": "mug", "r": "holds", "t": "tea", name: 0.25}]),
    }  # fmt: skip
    for file, text in tables.items():
        with pytest.warns(
            DataWarning, match="1 facts of confidence 0, which state nothing"
        ):
            graph = read_graph(write(tmp_path / file, text))
        assert (list(graph), graph.confidence) == ([*DOUBTED], DOUBTED)


@pytest.mark.parametrize("value", ["1.5", "-1", "sure", "nan", "95%"])
def test_a_confidence_that_is_no_probability_is_refused(tmp_path, value):
    path = write(
        tmp_path / "a.csv",
        f"head,relation,tail,confidence\nmug,usedFor,drinking,{value}\n",
    )
    with pytest.raises(
        UserError, match=f"line 2: the confidence is '{value}'; .* from 0 to 1"
    ):
        read_graph(path)


ONTOLOGY = {
    "ofn": """Prefix(:=<http://e.org/>)
Prefix(rdfs:=<http://www.w3.org/2000/01/rdf-schema#>)
Ontology(<http://e.org/o>
AnnotationAssertion(rdfs:label :mug "Becher"@en)
SubClassOf(:mug ObjectIntersectionOf(:cup ObjectSomeValuesFrom(:usedFor :drinking)))
ClassAssertion(:mug :m1)
ObjectPropertyAssertion(:on :m1 :table)
)""",
    "omn": """Prefix: : <http://e.org/>
Prefix: rdfs: <http://www.w3.org/2000/01/rdf-schema#>
Ontology: <http://e.org/o>
ObjectProperty: usedFor
ObjectProperty: on
Class: drinking
Class: cup
Class: mug
    Annotations: rdfs:label "Becher"@en
    SubClassOf: cup and (usedFor some drinking)
Individual: table
Individual: m1
    Types: mug
    Facts: on table
""",
    "owx": """<?xml version="1.0"?>
<Ontology xmlns="http://www.w3.org/2002/07/owl#" ontologyIRI="http://e.org/o">
<Prefix name="" IRI="http://e.org/"/>
<AnnotationAssertion><AnnotationProperty IRI="http://www.w3.org/2000/01/rdf-schema#label"/>
<IRI>http://e.org/mug</IRI><Literal xml:lang="en">Becher</Literal></AnnotationAssertion>
<SubClassOf><Class IRI="http://e.org/mug"/><ObjectIntersectionOf><Class IRI="http://e.org/cup"/>
<ObjectSomeValuesFrom><ObjectProperty IRI="http://e.org/usedFor"/>
<Class IRI="http://e.org/drinking"/></ObjectSomeValuesFrom></ObjectIntersectionOf></SubClassOf>
<ClassAssertion><Class IRI="http://e.org/mug"/><NamedIndividual IRI="http://e.org/m1"/>
</ClassAssertion>
<ObjectPropertyAssertion><ObjectProperty IRI="http://e.org/on"/>
<NamedIndividual IRI="http://e.org/m1"/><NamedIndividual IRI="http://e.org/table"/>
</ObjectPropertyAssertion></Ontology>""",
}  # fmt: skip


@pytest.mark.parametrize("suffix", ["its own", "owl"])
@pytest.mark.parametrize("syntax", ONTOLOGY)
def test_an_ontology_states_the_same_in_every_syntax(tmp_path, syntax, suffix):
    name = syntax if suffix == "its own" else suffix
    with pytest.warns(DataWarning, match="4 triples follow from axioms"):
        graph = read_graph(write(tmp_path / f"a.{name}", ONTOLOGY[syntax]))
    named = {
        t
        for t in graph
        if not any(each.startswith("_:") for each in t) and "w3.org" not in t[1]
    }
    assert named == {
        E_MUG,
        (E + "m1", E + "usedFor", E + "drinking"),
        (E + "m1", E + "on", E + "table"),
    }
    assert graph.own_labels()[E + "mug"] == "Becher"


def test_terms_of_obo_are_read(tmp_path):
    text = "format-version: 1.2\nontology: x\n\n[Term]\nid: X:1\nname: mug\nrelationship: in X:3\n"
    with pytest.warns(DataWarning, match="1 triples follow"):
        graph = read_graph(write(tmp_path / "a.obo", text))
    obo = "http://purl.obolibrary.org/obo/"
    assert (obo + "X_1", obo + "x#in", obo + "X_3") in set(graph)


ADMINISTRATION = """format-version: 1.4
ontology: h
date: 01:02:2024 10:00
saved-by: someone
default-namespace: household
subsetdef: kitchen "Things of the kitchen"

[Term]
id: H:0001
name: mug
namespace: household
alt_id: H:0009
def: "A cup with a handle." [ISBN:123]
subset: kitchen
synonym: "beaker" EXACT [X:1]
xref: Wikidata:Q81727
is_a: H:0002 ! cup
relationship: used_for H:0003 ! drinking
created_by: brush
creation_date: 2011-02-03T10:00:00Z

[Term]
id: H:0002
name: cup

[Term]
id: H:0003
name: drinking
"""


@pytest.mark.parametrize("suffix", ["obo", "owl", "ttl"])
def test_administrative_annotations_of_obo_are_left_out_with_a_line(tmp_path, suffix):
    path = write(tmp_path / "a.obo", ADMINISTRATION)
    if suffix != "obo":  # as others publish such ontologies
        ontology = pyhornedowl.open_ontology_from_string(ADMINISTRATION, "obo")
        text = ontology.save_to_string("owl")
        path = tmp_path / f"a.{suffix}"
        rdflib.Graph().parse(data=text, format="xml").serialize(
            path, format="xml" if suffix == "owl" else "turtle"
        )
    left_out = "are left out: .*created_by, creation_date, .*hasDbXref, .*hasOBONamespace, id, inS"
    with pytest.warns(
        DataWarning, match=f"administrative annotations of OBO {left_out}"
    ):
        graph = read_graph(path)
    mug = graph.entity_id("mug")
    said = {
        local_name(graph.relation_names[graph.relations[row]])
        for row in graph.out_rows(mug)
    }
    assert said == {"subClassOf", "type", "used_for", "hasExactSynonym", "IAO_0000115"}
    for name in (
        "id",
        "brush",
        "household",
        "kitchen",
        "created by",
        "Wikidata:Q81727",
    ):
        assert graph.find_entity(name) is None
        assert graph.find_relation(name) is None
        assert not graph.names.find_literals(name)


def test_references_that_are_malformed_cost_no_ontology(tmp_path):
    xref = "xref: https://en.wikipedia.org/wiki/Forests\\,_scrub\\,_or_woodlands"
    text = ADMINISTRATION.replace("xref: Wikidata:Q81727", xref)
    with pytest.warns(DataWarning, match="administrative annotations"):
        graph = read_graph(write(tmp_path / "a.obo", text))
    with pytest.warns(DataWarning, match="administrative annotations"):
        assert graph == read_graph(write(tmp_path / "b.obo", ADMINISTRATION))
    broken = ADMINISTRATION.replace("is_a: H:0002", "is_a H:0002")
    with pytest.raises(UserError, match="line 17: not well-formed OBO"):
        read_graph(write(tmp_path / "a.obo", broken))


def test_what_has_administrative_annotations_alone_is_kept_and_prefixes_too(tmp_path):
    text = """
    @prefix o: <http://www.geneontology.org/formats/oboInOwl#> . @prefix h: <http://h.org/> .
    @prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
    h:mug h:on h:table . h:lone o:id "L:1" ; rdfs:label "lonely" . o:id h:of h:nobody .
    """
    with pytest.warns(DataWarning, match="2 administrative annotations"):
        graph = read_graph(write(tmp_path / "a.ttl", text))
    assert list(graph) == [
        ("http://h.org/mug", "http://h.org/on", "http://h.org/table")
    ]
    assert (
        graph.find_entity("lonely")
        == graph.find_entity("http://h.org/lone")
        is not None
    )
    assert set(map(local_name, graph.entities)) == {"mug", "table", "lone"}
    assert SparqlQuery(graph, "SELECT ?x { ?x h:on h:table }").answer().rows


def test_xml_of_another_kind_is_no_table(tmp_path):
    text = '<?xml version="1.0"?>\n<module>\n<a>1, 2, 3</a>\n- x, y, z\n- u, v, w\n</module>'
    with pytest.raises(UserError, match="not well-formed RDF/XML"):
        read_graph(write(tmp_path / "a.xml", text))


def test_dates_of_other_graphs_are_kept(tmp_path):
    text = "@prefix d: <http://purl.org/dc/terms/> . <urn:knowarm:book> d:creator <urn:knowarm:i> ."
    assert len(read_graph(write(tmp_path / "a.ttl", text))) == 1


BRACKETS = {
    "an empty one": (
        "[] <http://e.org/p> <http://e.org/o> .",
        ["a.ttl", "a.trig", "a.txt", "a.n3"],
    ),
    "with a blank": (
        "# a\n[ ] <http://e.org/p> <http://e.org/o> .",
        ["a.ttl", "a.trig", "a.txt"],
    ),
    "of a prefix": (
        "@prefix e: <http://e.org/> . [] e:p e:o .",
        ["a.ttl", "a.trig", "a.txt"],
    ),
    "with a predicate": (
        "[ <http://e.org/p> <http://e.org/o> ] .",
        ["a.ttl", "a.trig"],
    ),
    "of a graph": (
        "[] { <http://e.org/s> <http://e.org/p> <http://e.org/o> . }",
        ["a.trig"],
    ),
    "a collection": ("() <http://e.org/p> <http://e.org/o> .", ["a.ttl", "a.trig"]),
}


@pytest.mark.parametrize(("text", "names"), BRACKETS.values(), ids=BRACKETS)
def test_turtle_that_begins_with_brackets(tmp_path, text, names):
    """Case 07."""
    for name in names:
        ((_, relation, tail),) = read_graph(write(tmp_path / name, text))
        assert (relation, tail) == (E + "p", E + "o")


RELATIVE = """<?xml version="1.0"?>
<rdf:RDF xmlns="test_kitchen#" xml:base="test_kitchen" xmlns:e="http://e.org/"
 xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description rdf:about="#mug"><usedFor rdf:resource="test_kitchen#drinking"/></rdf:Description>
<rdf:Description rdf:ID="bowl"><e:on rdf:resource=""/></rdf:Description>
<rdf:Description xml:base="deeper/a" rdf:about="#lamp"><e:on rdf:resource="b"/></rdf:Description>
<rdf:Description rdf:about="#lamp"><e:on rdf:resource="http://e.org/desk"/></rdf:Description>
</rdf:RDF>"""


@pytest.mark.parametrize("text", [
    RELATIVE,
    RELATIVE.replace(' xml:base="test_kitchen"', ""),
    RELATIVE.replace('xml:base="test_kitchen"', 'xml:base=""'),
    RELATIVE.replace('xml:base="test_kitchen"', 'xml:base="http://e.org/home"'),
    RELATIVE.replace('xml:base="test_kitchen"', 'xml:base="../other/#part"'),
])  # fmt: skip
def test_relative_bases_of_xml_are_what_rdflib_reads(tmp_path, text):
    """Case 13."""
    path = write(tmp_path / "a.owl", text)
    triples = {
        tuple(map(str, triple)) for triple in rdflib.Graph().parse(path, format="xml")
    }
    assert set(read_graph(path)) == triples


REFUSED = [
    ("a.csv", "", "holds no triples"),
    ("a.csv", "head,relation,tail\n", "holds no triples"),
    ("a.csv", "mug,usedFor,drinking,1.0\n", "has 4 columns, but a row has 3"),
    ("a.csv", "Source,Target,Weight\nmug,lamp,2\n", "Target, Weight names the relation"),
    ("a.json", '{"nodes": [{"id": "mug"}], "links": []}', "holds no triples"),
    ("a.json", '{"entities": {"Q1": {"labels": {}}}}', "this JSON is neither JSON-LD nor a graph"),
    ("a.json", '[{"image_id": 1, "relationships": []}]', "is no link with the names of a head"),
    ("a.json", '{"nodes": [{"id": ["a"]}], "links": []}', "a node is named by text or a number"),
    ("a.json", '[["mug", "usedFor"]]', "is no link"),
    ("a.json", '[["mug", "usedFor", "drinking"]', "a.json, line 1: not well-formed JSON"),
    ("a.json", '[{"source": "mug", "target": "lamp", "weight": 3}]', "names the relation"),
    ("a.jsonld", '{"@context": {"usedFor": "http://e.org/usedFor"}}', "holds no triples"),
    ("a.graphml", GRAPHML.replace("directed", "undirected"), "edges without a direction"),
    ("a.graphml", GRAPHML.replace("label", "weight"), "names the relation"),
    ("a.owl", "Prefix(:=<http://e.org/>)\nOntology(<http://e.org/o>", "line 2: .*functional"),
    ("a.omn", "Prefix: : <http://e.org/>\nOntology: <http://e.org/o>\nClass: Mug SubClassOf some",
     "line 3: not well-formed OWL Manchester syntax"),
    ("a.owl", '<?xml version="1.0"?>\n<Ontology xmlns="http://www.w3.org/2002/07/owl#">\n<D',
     "line 3: not well-formed OWL/XML"),
    ("a.ttl", "<!DOCTYPE html><html><body>404</body></html>", "this is an HTML page"),
    ("a.rdf", XML.replace("'http://e.org/'", "SYSTEM 'file:///etc/passwd'"), "external entity"),
    ("a.rdf", XML.replace("[ <", "SYSTEM 'a' [ <").replace("Köln", "&x;"), "document, 'a',"),
    ("a.rdf", XML[:-20], r"line \d: not well-formed RDF/XML"),
    ("a.n3", TURTLE + "{ :a :b :c } => { :d :e :f } .", "formulas in braces"),
    ("a.ttl", TURTLE + ":mug :usedFor", "not well-formed Turtle"),
    ("a.nt", "<urn:a> <urn:b> <urn:c> .\n<urn:d> <urn:e>\n<urn:d> <urn:e>\n", "line 3: not well-"),
    ("a.nt", "<urn:a> <urn:b> <urn:c> .\n<urn:d> <ur", "line 2: .*Unexpected end of file"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "content", "message"), REFUSED)
def test_what_is_no_graph_or_a_cut_one_is_refused_in_one_line(
    tmp_path, name, content, message
):
    with pytest.raises(UserError, match=message) as error:
        read_graph(write(tmp_path / name, content))
    assert "\n" not in str(error.value)


def test_xml_with_entities_and_another_encoding(tmp_path):
    graph = read_graph(write(tmp_path / "a.rdf", XML.encode("latin-1")))
    note = (E + "mug", E + "note", literal("Köln:\nPrefix(:=<http://e.org/>)\n"))
    assert set(graph) == {E_MUG, note}
    for encoding in ("utf-16", "utf-8-sig"):
        text = XML.replace("ISO-8859-1", encoding.removesuffix("-sig"))
        assert read_graph(write(tmp_path / "b.rdf", text.encode(encoding))) == graph


def test_labels_of_nodes_and_columns(tmp_path):
    with warnings.catch_warnings(
        action="error"
    ):  # also none of networkx, of a key without a type
        graph = read_graph(write(tmp_path / "a.graphml", GRAPHML))
    assert list(graph) == [("n0", "usedFor", "n1")]
    assert graph.labels == {"n0": "Mug"}
    kgtk = (
        "node1\tlabel\tnode2\tnode1;label\tlabel;label\tnode2;label\n"
        "Q1\tP1\tQ2\tmug\tused for\t\n"
    )
    graph = read_graph(write(tmp_path / "a.tsv", kgtk))
    assert list(graph) == [("Q1", "P1", "Q2")]
    assert graph.labels == {"Q1": "mug", "P1": "used for"}


def test_a_malformed_iri_costs_its_triple_only(tmp_path):
    text = TURTLE + "".join(
        f":mug :holds <http://e.org/{i} x>, :tea{i}, :milk{i} .\n" for i in "01"
    )
    with pytest.warns(
        DataWarning, match=r"2 triples with a malformed IRI.*in line 3, 4: Invalid"
    ):
        graph = read_graph(
            write(
                tmp_path / "a.ttl",
                text + ":a :b " + ", ".join(f":c{i}" for i in range(20)) + " .",
            )
        )
    held = {tail for _, relation, tail in graph if relation == "holds"}
    assert held == {"tea0", "milk0", "tea1", "milk1"}
    assert len(graph) == 25


def test_letters_of_two_forms_are_one_name(tmp_path):
    path = write(tmp_path / "a.csv", "caf\u00e9,isA,place\ncafe\u0301,sells,coffee\n")
    assert read_graph(path).entities == ["café", "coffee", "place"]


@pytest.mark.parametrize("separator", [" ", ","])
def test_a_triple_in_two_parts_is_read(tmp_path, separator):
    for name, text in {
        "entity2id.txt": "2\nmug\t0\ndrinking\t1\n",
        "relation2id.txt": "1\nusedFor\t0\n",
        "train2id.txt": "1\n0 1 0\n".replace(" ", separator),
        "test2id.txt": "1\n0 1 0\n",
    }.items():
        (tmp_path / name).write_text(text)
    assert list(read_graph(tmp_path)) == [MUG]


def test_a_folder_of_train_valid_and_test(tmp_path):
    (tmp_path / "train.txt").write_text(
        "mug\tusedFor\tdrinking\nbottle\tusedFor\tdrinking\n"
    )
    (tmp_path / "valid.txt").write_text(
        "head\trelation\ttail\tconfidence\npot\tusedFor\tcooking\t0.5\n"
    )
    graph = read_graph(tmp_path)
    assert graph.confidence == {("pot", "usedFor", "cooking"): 0.5}
    assert set(graph) == {MUG, BOTTLE, ("pot", "usedFor", "cooking")}
    _, parts = read_parts(tmp_path)
    assert {name: len(part) for name, part in parts.items()} == {
        "train": 2,
        "valid": 1,
        "test": 0,
    }
    assert parts["valid"] == [("pot", "usedFor", "cooking")]


LETTERS = st.characters(
    categories=["Lu", "Ll", "Nd"], exclude_characters="ªµº", max_codepoint=0x24F
)
WORD = st.text(LETTERS | st.sampled_from(" ,;|%()'-_/&<"), min_size=1, max_size=5).map(
    str.strip
)
NAME = st.one_of(
    st.sampled_from(
        [
            "mug",
            "light_blue",
            "cereal box",
            "a, b",
            "x;y",
            'the "cup"',
            "50%",
            "wine|glass",
        ]
    ),
    WORD.map(lambda text: "x" + text),
    WORD.map(lambda text: E + "".join(filter(str.isalnum, text))),
)
CELL = NAME.map(lambda text: " ".join(text.split()))  # tables have single blanks
RELATION = st.sampled_from(["usedFor", "isA", E + "hasPart", E + "P1"])
LITERAL = WORD.map(literal) | WORD.map(
    lambda text: literal(text + " \n", language="en")
)
MANY = settings(max_examples=thorough(10, 40), deadline=None)
RDF = {"ttl": "turtle", "nt": "nt", "rdf": "xml", "jsonld": "json-ld"}
MORE = {
    "nq": "nquads",
    "trig": "trig",
    "n3": "n3",
    "owl": "turtle",
    "txt": "nt",
    "json": "json-ld",
}


def rdflib_triples(triples):
    """Return triples of names as rdflib's terms, made by the rules that the reference states."""
    terms = []
    for triple in triples:
        found = [rdflib.URIRef(iri_of_name(name)) for name in triple]
        if (text := parse_literal(triple[2])) is not None:
            found[2] = rdflib.Literal(text.value, lang=text.language)
        terms.append(tuple(found))
    return set(terms)


@pytest.mark.parametrize("suffix", RDF)
@MANY
@given(
    triples=st.lists(st.tuples(NAME, RELATION, NAME | LITERAL), min_size=1, max_size=12)
)
def test_rdflib_reads_what_is_written(tmp_path_factory, suffix, triples):
    path = tmp_path_factory.mktemp("graph") / f"a.{suffix}"
    write_graph(graph_of(triples), path)
    assert set(rdflib.Graph().parse(path, format=RDF[suffix])) == rdflib_triples(
        triples
    )


@pytest.mark.parametrize("suffix", RDF | MORE)
@MANY
@given(
    triples=st.lists(st.tuples(NAME, RELATION, NAME | LITERAL), min_size=1, max_size=12)
)
def test_what_rdflib_writes_is_read(tmp_path_factory, suffix, triples):
    path = tmp_path_factory.mktemp("graph") / f"a.{suffix}"
    graph = rdflib.Dataset() if suffix in ("nq", "trig") else rdflib.Graph()
    for triple in rdflib_triples(triples):
        graph.add(triple)
    graph.serialize(path, format=(RDF | MORE)[suffix])
    assert read_graph(path) == graph_of(triples)


def as_csv(triples, separator, encoding="utf-8", header=("head", "relation", "tail")):
    text = io.StringIO()
    order = [["head", "relation", "tail"].index(name) for name in header]
    rows = [[triple[i] for i in order] for triple in triples]
    csv.writer(text, delimiter=separator).writerows([header, *rows])
    return text.getvalue().encode(encoding)


def as_graphml(triples):
    graph = networkx.MultiDiGraph()
    for head, relation, tail in triples:
        graph.add_edge(head, tail, label=relation)
    return "\n".join(networkx.generate_graphml(graph)).encode()


def as_gexf(triples):
    graph = networkx.MultiDiGraph()
    for head, relation, tail in triples:
        graph.add_edge(head, tail, label=relation)
    return "\n".join(networkx.generate_gexf(graph)).encode()


def as_node_link(triples):
    graph = networkx.MultiDiGraph()
    for head, relation, tail in triples:
        graph.add_edge(head, tail, relation=relation)
    return json.dumps(networkx.node_link_data(graph, edges="links")).encode()


OTHERS = {
    "comma.csv": lambda triples: as_csv(triples, ","),
    "semicolon.csv": lambda triples: as_csv(triples, ";", "utf-8-sig"),
    "excel.csv": lambda triples: as_csv(triples, "\t", "utf-16"),
    "bar.txt": lambda triples: as_csv(
        triples, "|", header=("tail", "head", "relation")
    ),
    "tabs.tsv": lambda triples: as_csv(triples, "\t"),
    "lists.json": lambda triples: json.dumps(triples, indent=1).encode(),
    "links.json": as_node_link,
    "a.graphml": as_graphml,
    "a.gexf": as_gexf,
}


@pytest.mark.parametrize("name", OTHERS)
@MANY
@given(triples=st.lists(st.tuples(CELL, RELATION, CELL), min_size=1, max_size=12))
def test_what_other_libraries_write_is_read(tmp_path_factory, name, triples):
    path = write(tmp_path_factory.mktemp("graph") / name, OTHERS[name](triples))
    assert read_graph(path) == graph_of(triples)
