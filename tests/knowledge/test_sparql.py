"""SPARQL: the store that is kept with a graph, prefixes of the file, and hints."""

import gc
import json
from concurrent.futures import ThreadPoolExecutor

import pytest
from pyoxigraph import RdfFormat, Store

from knowarm.cli.main import main
from knowarm.errors import UserError
from knowarm.knowledge import gamma, graph_of, household, read_graph, write_graph
from knowarm.knowledge.graph.builder import union
from knowarm.knowledge.graph.edits import edited
from knowarm.knowledge.queries import store as stores
from knowarm.knowledge.queries.sparql import SparqlQuery, sparql

USED = "SELECT ?x { ?x :usedFor :drinking }"
HAZARDS = {
    "a.ttl": "@prefix : <http://x#> . :knife :isA :hazard .",
    "a.trig": "@prefix : <http://x#> . :g { :knife :isA :hazard . }",
    "a.rdf": """<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"
        xmlns="http://x#"><rdf:Description rdf:about="http://x#knife">
        <isA rdf:resource="http://x#hazard"/></rdf:Description></rdf:RDF>""",
    "late.ttl": "<http://x#knife> <http://x#isA> <http://x#hazard> . PREFIX : <http://x#> "
    ":knife :isA :tool .",
}


def test_the_store_is_made_once_per_graph_and_goes_with_it(monkeypatch):
    made = []
    quads_of = stores._quads

    def noting(graph):
        made.append(len(graph))
        return quads_of(graph)

    monkeypatch.setattr(stores, "_quads", noting)
    graph = graph_of([("mug", "usedFor", "drinking"), ("cup", "isA", "mug")])
    gc.collect()  # of graphs of other tests
    kept = len(stores._STORES)
    for _ in range(3):
        assert sparql(graph, USED).rows == (("mug",),)
    assert made == [2]
    part = gamma(graph, ["cup"])
    assert sparql(part, USED).rows == ()  # a subgraph has its own
    more = edited(graph, ["+ cup usedFor drinking"])
    assert sparql(more, USED).rows == (("cup",), ("mug",))
    assert made == [2, 1, 3]
    del graph, part, more
    gc.collect()
    assert len(stores._STORES) == kept


def test_the_store_holds_what_a_file_of_the_graph_does(tmp_path):
    graph = graph_of(
        [
            ("mug", "used for", "a b"),
            ("http://x#mug", "http://x#p", '"1.5"^^<http://www.w3.org/2001/XMLSchema#float>'),
            ("http://x#mug", "http://x#p", '"Tasse \\"é\\""@de'),
            ('"text"', "http://x#p", "_:b1"),
            ("_:b1", "p", "_:b1"),
            ("_:a:b", '"q"', "café"),
        ],
        labels={"mug": "a mug", "http://x#p": "pp"},
    )  # fmt: skip
    write_graph(graph, tmp_path / "a.nt")
    file = Store()
    file.bulk_load(path=tmp_path / "a.nt", format=RdfFormat.N_TRIPLES)
    names = graph_of(sparql(graph, "SELECT ?s ?p ?o { ?s ?p ?o }").rows)
    assert len(names) == len(file) == 8
    assert len(set(graph) - set(names)) == 2  # a literal as head or relation


def test_what_a_block_states_is_taken_back_after_an_error():
    graph = household()
    query = SparqlQuery(graph, "SELECT ?c { :mug :hasColor ?c }")
    before = query.answer().rows
    limited = "SELECT ?s ?c { ?s :hasColor ?c } LIMIT 3"
    first = sparql(graph, limited)

    def fail(colours):
        with stores.stating(query.store, "mug", ["hasColor"], colours):
            stated = {(colour,) for colour in colours} or set(before)
            assert set(query.answer().rows) == stated
            raise ZeroDivisionError

    for colours in (["green"], [], ["red"], ["blue", "black"]):
        with pytest.raises(ZeroDivisionError):
            fail(colours)
        assert query.answer().rows == before
    assert sparql(graph, limited) == first  # the order of the triples is the same, too


def test_threads_do_not_see_what_another_one_states():
    graph = household()
    colours = [f"colour{number}" for number in range(8)]
    before = sparql(graph, "SELECT ?c { :mug :hasColor ?c }").rows

    def ask(colour):
        query = SparqlQuery(graph, "SELECT ?c { :mug :hasColor ?c }")
        with stores.stating(query.store, "mug", ["hasColor"], [colour]):
            inside = [query.answer().rows for _ in range(2)]
        return set(inside)

    def read(_):
        return {sparql(graph, "SELECT ?c { :mug :hasColor ?c }").rows for _ in range(2)}

    with ThreadPoolExecutor(8) as pool:
        asked = pool.map(ask, colours)
        looked = pool.map(read, range(4))
        assert list(asked) == [{((colour,),)} for colour in colours]
        assert list(looked) == [{before}] * 4


@pytest.mark.parametrize("name", HAZARDS)
def test_a_query_knows_the_prefixes_of_the_file(tmp_path, name):
    path = tmp_path / name
    path.write_text(HAZARDS[name])
    graph = read_graph(path)
    hazards = "SELECT ?x { ?x :isA :hazard }"
    knife = (("http://x#knife",),)
    assert sparql(graph, hazards).rows == knife
    # The prefixes of the query go first.
    assert sparql(graph, f"PREFIX : <urn:knowarm:> {hazards}").rows == ()
    other = "PREFIX y: <http://x#> SELECT ?x { ?x y:isA y:hazard }"
    assert sparql(graph, other).rows == knife
    plain = graph_of([("fork", "isA", "tool")])
    for same in (
        edited(graph, ["+ http://x#fork http://x#isA http://x#tool"]),
        gamma(graph, ["http://x#knife"]),
        union(graph, plain),
        union(plain, graph),
    ):
        assert sparql(same, hazards).rows == knife
    assert sparql(union(plain, plain), "SELECT ?x { ?x :isA :tool }").rows == (
        ("fork",),
    )


def test_prefixes_that_are_relative_malformed_or_missing(tmp_path):
    path = tmp_path / "a.ttl"
    path.write_text("@prefix : <#> . @prefix e: <http://x#> . :knife e:isA :hazard .")
    assert sparql(read_graph(path), "ASK { ?x e:isA :hazard }").rows == (("yes",),)
    path.write_text("@prefix e: <http://x#> . e:knife e:isA <urn:knowarm:hazard> .")
    assert sparql(read_graph(path), "ASK { ?x e:isA :hazard }").rows == (("yes",),)
    path.write_text(
        "@prefix s: <http://a b/> . @prefix e: <http://x#> . e:knife e:isA e:tool ."
    )
    with pytest.warns(UserWarning, match="malformed"):
        graph = read_graph(path)
    assert sparql(graph, "ASK { e:knife e:isA e:tool }").rows == (("yes",),)
    path = tmp_path / "a.csv"
    path.write_text("knife,isA,hazard\n")
    assert sparql(read_graph(path), "ASK { :knife :isA :hazard }").rows == (("yes",),)


def test_an_unknown_prefix_is_named_with_the_known_ones(tmp_path):
    path = tmp_path / "a.ttl"
    path.write_text(HAZARDS["a.ttl"] + "@prefix kitchen: <http://k#> .")
    graph = read_graph(path)
    query = 'SELECT ?x { ?x :isA "y:" ; kitchn:in ?y # z:'
    with pytest.raises(UserError, match=r"prefix kitchn:.* Known: :, .*kitchen:"):
        sparql(graph, query + "\n}")
    remedy = "PREFIX kitchn: <http://k#> "
    assert sparql(graph, remedy + query + "\n}").rows == ()


@pytest.mark.parametrize(
    ("query", "missing"),
    [
        ("SELECT ?x { ?x :isA :hazzard }", ["<http://x#hazzard>"]),
        ("ASK { ?x <urn:knowarm:isA> ?y }", ["<urn:knowarm:isA> (but <http://x#isA>)"]),
        ("BASE <http://y> SELECT ?x { ?x :isA <#a> }", ["<http://y#a>"]),
        ("PREFIX a: <http://y#> CONSTRUCT WHERE { ?x :isA a:tool\\,s }", ["<http://y#tool,s>"]),
        ('SELECT ?x { ?x :isA ?y FILTER(xsd:integer(?y) > "1"^^xsd:integer) }', []),
        ("SELECT ?x { :knife :isA :hazard . FILTER(?x != ':a') # :b\n }", []),
    ],
)  # fmt: skip
def test_nobody_answers_and_the_hint_names_what_the_graph_lacks(
    tmp_path, capsys, query, missing
):
    path = tmp_path / "a.ttl"
    path.write_text(HAZARDS["a.ttl"])
    words = ["knowledge", "subgraph", "--graph", str(path), "--sparql", query]
    assert main([*words, "--json", str(tmp_path / "a.json")]) == 0
    lines = capsys.readouterr().out.splitlines()
    hints = [line for line in lines if "does not hold" in line]
    assert hints == [f"The graph does not hold {name}." for name in missing]
    assert not json.loads((tmp_path / "a.json").read_text()).get("facts")


@pytest.mark.parametrize(
    "pattern",
    [
        "?object ?p ?x",
        "?object :usedFor ?u ; ?p :red",
        ":mug ?p ?object",
        "?object !:usedFor ?x",
        "?object :a|!(:b|:c) ?x",
        "?object :usedFor* ?x",
        "?object :usedFor? ?x",
        "[ ?p ?object ]",
        "?object :hasColor :red",
        "?object <http://x#hasColor> :red",
        "?object c:olor :red",
        "?object <urn:knowarm:has\\u0043olor> :red",
        '?object ?p "red"',
        "?object?p?x",
        "?object # {\n ?p ?x",
        "?x :a ?object . ?object\n?p\n?y",
        "{ ?object :usedFor ?x } UNION { ?object ?q <x:y> }",
        "?object ?p []",
        "?object ?p (1)",
        "?object ?p true",
        "?object ?p k:x",
        "?object $p ?x",
        "?object ?p _:x",
        "?object ?p .5",
        "?object ?p -5",
    ],
)
def test_colours_may_be_read_where_any_relation_may(pattern):
    query = f"PREFIX c: <urn:knowarm:hasC> SELECT ?object {{ {pattern} }}"
    assert SparqlQuery(household(), query).may_read("hasColor")


@pytest.mark.parametrize(
    "pattern",
    [
        "?object :usedFor :drinking",
        "?object :usedFor ?u . ?u :relatedTo ?t FILTER(?t != :tea)",
        "?object :usedFor/:relatedTo+ ?x MINUS { ?object :isA ?y }",
        "?object a :Cup ; :on ?t , ?u1 . ?t :in ?v",
        "{ ?object :a ?x } UNION { ?object :b 'x ?p ?o' }",
        "?object :p ?x OPTIONAL { ?x :q ?y } # ?a ?p ?o\n",
        "?object :p 5 . ?x :q ?object",
        "VALUES ?x { :a :b } ?object :p ?x",
    ],
)
def test_colours_are_not_read_where_all_relations_are_named(pattern):
    query = f"SELECT ?object {{ {pattern} }} ORDER BY ?object LIMIT 3"
    assert not SparqlQuery(household(), query).may_read("hasColor")
