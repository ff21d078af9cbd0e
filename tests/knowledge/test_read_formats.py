import gzip
import json

import pytest

from knowarm.errors import DataWarning, UserError
from knowarm.knowledge import graph_of, household, read_graph
from knowarm.knowledge.formats import WRITTEN, write_graph
from knowarm.knowledge.formats.tables import read_conceptnet
from knowarm.knowledge.graph.builder import union
from knowarm.knowledge.graph.edits import edited
from knowarm.knowledge.graph.terms import literal
from knowarm.knowledge.queries.sparql import sparql

OWL = """<?xml version="1.0"?>
<rdf:RDF xmlns="http://a.org/home#" xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"
         xmlns:rdfs="http://www.w3.org/2000/01/rdf-schema#" xmlns:owl="http://www.w3.org/2002/07/owl#">
  <owl:Class rdf:about="http://a.org/home#Mug">
    <rdfs:label xml:lang="en">coffee mug</rdfs:label>
    <rdfs:label xml:lang="de">Tasse</rdfs:label>
    <rdfs:subClassOf rdf:resource="http://a.org/home#Cup"/>
  </owl:Class>
</rdf:RDF>"""


def test_owl_in_rdf_xml(tmp_path):
    path = tmp_path / "home.owl"
    path.write_text(OWL)
    graph = read_graph(path)
    assert len(graph) == 2
    assert graph.labels == {"http://a.org/home#Mug": "coffee mug"}
    assert graph.entity_id("Mug") == graph.entity_id("coffee mug")


def test_json_ld(tmp_path):
    path = tmp_path / "home.jsonld"
    content = {
        "@context": {"@vocab": "urn:knowarm:", "isA": {"@type": "@id"}},
        "@id": "urn:knowarm:mug",
        "isA": "urn:knowarm:cup",
        "weight": 0.5,
    }
    path.write_text(json.dumps(content))
    graph = read_graph(path)
    assert ("mug", "isA", "cup") in graph
    assert len(graph) == 2


N_TRIPLES = r"""# a comment
_:b1  <http://a.org/p>	<urn:knowarm:cereal%20box> . # trailing comment
<http://a.org/x> <http://a.org/p> "tab\t quote\" back\\slash \u00e9 \U0001F600"@de-AT .
<http://a.org/caf\u00e9> <http://a.org/p> <http://a.org/\U000000e9> .
<http://a.org/caf\u00e9> <http://a.org/p> <http://a.org/\U000000e9> .
"""


def test_compressed_n_triples_with_windows_line_ends(tmp_path):
    path = tmp_path / "a.nt.gz"
    with gzip.open(path, "wt", newline="") as file:
        file.write(N_TRIPLES.replace("\n", "\r\n"))
    p = "http://a.org/p"
    assert set(read_graph(path)) == {
        ("_:b1", p, "cereal box"),
        (
            "http://a.org/x",
            p,
            literal('tab\t quote" back\\slash é \U0001f600', language="de-AT"),
        ),
        ("http://a.org/café", p, "http://a.org/é"),
    }
    path.write_bytes(path.read_bytes()[:20])
    with pytest.raises(UserError, match="is damaged or of another format"):
        read_graph(path)


def test_tables_with_and_without_a_header(tmp_path):
    for name, text in {
        "a.csv": 'head,relation,tail\nmug,isA,cup\n"mug, big",isA,"the ""cup"""\n\n',
        "b.tsv": 'mug\tisA\tcup\nmug, big\tisA\tthe "cup"\n',
    }.items():
        path = tmp_path / name
        path.write_text(text)
        expected = {("mug", "isA", "cup"), ("mug, big", "isA", 'the "cup"')}
        assert set(read_graph(path)) == expected


def test_spaces_after_the_commas_are_no_part_of_the_names(tmp_path):
    path = tmp_path / "home.csv"
    path.write_text(
        'head, relation, tail\nmug, usedFor, drinking\nmug, isA, "cup, small"\n'
    )
    assert set(read_graph(path)) == {
        ("mug", "usedFor", "drinking"),
        ("mug", "isA", "cup, small"),
    }


def test_shipped_graphs_are_read_by_their_names():
    assert set(read_graph("household")) == set(household())


def test_openke_ids_may_come_in_any_order(tmp_path):
    (tmp_path / "entity2id.txt").write_text("3\nred\t1\nmug\t0\nbig cup\t2\n")
    (tmp_path / "relation2id.txt").write_text("2\nisA\t1\nhasColor\t0\n")
    (tmp_path / "train2id.txt").write_text("2\n0 1 0\n0 2 1\n")
    assert set(read_graph(tmp_path)) == {
        ("mug", "hasColor", "red"),
        ("mug", "isA", "big cup"),
    }


CONCEPTNET = "\n".join(
    f"/a/[{i}]\t{line}"
    for i, line in enumerate(
        [
            '/r/UsedFor\t/c/en/mug/n\t/c/en/drink_coffee\t{"weight": 2.0}',
            '/r/IsA\t/c/en/mug\t/c/en/cup\t{"weight": 1.0}',
            '/r/IsA\t/c/en/mug\t/c/en/face\t{"weight": 0.5}',
            '/r/IsA\t/c/de/tasse\t/c/de/gefäß\t{"weight": 2.0}',
            '/r/Synonym\t/c/en/mug\t/c/de/tasse\t{"weight": 2.0}',
        ]
    )
)


def test_conceptnet_is_filtered_while_it_is_read(tmp_path):
    path = tmp_path / "conceptnet-assertions-5.7.0.csv"
    path.write_text(CONCEPTNET)
    used = ("mug", "UsedFor", "drink_coffee")
    assert set(read_graph(path)) == {used, ("mug", "IsA", "cup")}
    assert set(read_conceptnet(path, relations=["UsedFor"])) == {used}
    assert set(read_conceptnet(path, languages=["de"])) == {("tasse", "IsA", "gefäß")}
    assert len(read_conceptnet(path, min_weight=0)) == 3


def test_sparql():
    graph = household()
    answer = sparql(graph, "SELECT ?c WHERE { :mug :hasColor ?c }")
    assert answer.columns == ("c",)
    assert answer.rows == (("blue",), ("red",))
    assert sparql(graph, "ASK { :mug :isA :fruit }").rows == (("no",),)
    built = sparql(
        graph, "CONSTRUCT { ?x :isA :red_thing } WHERE { ?x :hasColor :red }"
    ).graph
    assert built is not None
    assert ("apple", "isA", "red_thing") in built
    text = 'SELECT ?x WHERE { ?x <http://www.w3.org/2000/01/rdf-schema#label> "cereal box" }'
    assert sparql(graph, text).rows == (("cereal_box",),)


@pytest.mark.parametrize(
    "query", ["SELECT ?c WHERE {", "SELECT ?c WHERE { x:a ?b ?c }"]
)
def test_bad_sparql(query):
    with pytest.raises(UserError, match="SPARQL query, line 1, column"):
        sparql(household(), query)


def test_keywords_in_names_strings_and_comments_are_no_keywords():
    query = """# from {
        PREFIX from: <http://a.org/> PREFIX service: <http://a.org/>
        SELECT ?service WHERE { # from <http://a.org/> SERVICE <http://a.org/> { ?a ?b ?c }
        ?service :hasColor ?from . OPTIONAL { :room_service ?p ?from }
        FILTER(?from != "a \\"from" && ?from != :from)
        FILTER(?from != '''SERVICE :a {''' && ?from != service:from) }"""
    assert len(sparql(household(), query).rows) > 40
    labels = sparql(
        household(), "SELECT ?l { :mug rdfs:label ?l ; :isA ?o OPTIONAL { ?l :no ?x } }"
    )
    assert labels.columns == ("l",)


def test_rdf_xml_is_written_where_it_can_hold_the_relations(tmp_path):
    graph = graph_of(
        [("mug", "isA", "cup"), ("http://a.org/x", "isA", "a b")], labels={"mug": "M"}
    )
    write_graph(graph, tmp_path / "a.rdf")
    assert read_graph(tmp_path / "a.rdf") == graph
    with pytest.raises(
        UserError, match=r"cannot hold the relation 'is 1'.*Write Turtle"
    ):
        write_graph(graph_of([("a", "is 1", "b")]), tmp_path / "a.rdf")


def test_unnamed_blank_nodes_are_numbered_in_the_order_of_the_file(tmp_path):
    path = tmp_path / "a.ttl"
    path.write_text(
        "@prefix : <urn:knowarm:> .\n:a :p [ :q :b ], [ :q :c ] .\n_:x :p :a .\n"
    )
    first, second = read_graph(path), read_graph(path)
    assert list(first) == list(second)
    assert {name for name in first.entities if name.startswith("_:")} == {
        "_:unnamed0", "_:unnamed1", "_:x",
    }  # fmt: skip


def test_triples_about_triples_are_refused(tmp_path):
    path = tmp_path / "a.ttl"
    path.write_text("<< <a:b> <c:d> <e:f> >> <a:b> <c:d> .\n")
    with (
        pytest.warns(DataWarning, match=r"1 statements about triples"),
        pytest.raises(UserError, match="holds no triples"),
    ):
        read_graph(path)


def test_blank_nodes_keep_apart(tmp_path):
    """Those of two files, those of one file, and those that a query makes."""
    names = ("a.ttl", "b.ttl", "c.ttl")
    paths = [tmp_path / name for name in names]
    for path, text in zip(
        paths, ("[ :q :b ]", "[ :q :c ]", "[ :q :b ], _:unnamed0"), strict=True
    ):
        path.write_text(f"@prefix : <urn:knowarm:> .\n:{path.stem} :p {text} .\n")
    one, other, mixed = map(read_graph, paths)
    assert ("c", "p", "_:unnamed0") in mixed
    assert ("c", "p", "_:unnamed1") in mixed
    both = union(one, other)
    assert ("b", "p", "_:unnamed0") not in both
    assert list(sparql(both, "SELECT ?x { ?x :q :c }").rows) == [("_:unnamed1",)]
    assert edited(both, ["+ _:unnamed1 q d"]).find_entity("_:unnamed2") is None
    made = sparql(one, "CONSTRUCT { [] :of ?x } WHERE { ?y :p ?x }").graph
    assert list(made) == [("_:unnamed1", "of", "_:unnamed0")]


@pytest.mark.parametrize(
    "spelling", ["<urn:knowarm:caf%C3%A9>", ":café", "<urn:knowarm:café>"]
)
def test_letters_beyond_ascii_have_one_name(tmp_path, spelling):
    path = tmp_path / "a.ttl"
    path.write_text(
        f"@prefix : <urn:knowarm:> . {spelling} :isA :shop . :café :isA :bar .", "utf-8"
    )
    graph = read_graph(path)
    assert list(graph) == [("café", "isA", "bar"), ("café", "isA", "shop")]
    assert sparql(graph, "SELECT ?x { :café :isA ?x }").rows == (("bar",), ("shop",))
    for suffix in WRITTEN:
        write_graph(graph, tmp_path / f"b{suffix}")
        assert read_graph(tmp_path / f"b{suffix}") == graph


def test_blank_nodes_beyond_ascii_and_zero_bytes_in_iris(tmp_path):
    first, second = tmp_path / "a.ttl", tmp_path / "b.ttl"
    first.write_text("@prefix : <urn:knowarm:> . _:größe :p :a%00b .", "utf-8")
    graph = read_graph(first)
    assert graph.entities == ["_:größe", "urn:knowarm:a%00b"]
    write_graph(graph, second)
    assert "_:größe" in second.read_text("utf-8")
    with pytest.raises(UserError, match="zero byte"):
        graph_of([("a\0b", "p", "c")])


@pytest.mark.parametrize("name", ["a.ttl", "a.nt", "a.jsonld", "a.rdf", "a.csv"])
def test_a_byte_order_mark_is_skipped(tmp_path, name):
    graph = graph_of([("mug", "isA", "cup")])
    write_graph(graph, tmp_path / name)
    (tmp_path / name).write_bytes(b"\xef\xbb\xbf" + (tmp_path / name).read_bytes())
    assert read_graph(tmp_path / name) == graph


@pytest.mark.parametrize("name", ["a.csv", "a.tsv"])
def test_a_header_after_blank_lines_is_no_triple(tmp_path, name):
    (tmp_path / name).write_text(
        "\n\nhead,relation,tail\nmug,isA,cup\n".replace(
            ",", "," if name == "a.csv" else "\t"
        )
    )
    assert list(read_graph(tmp_path / name)) == [("mug", "isA", "cup")]
