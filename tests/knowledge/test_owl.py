"""Class axioms of OWL, read as facts."""

import pytest

from knowarm.errors import DataWarning
from knowarm.knowledge import graph_of, read_graph
from knowarm.knowledge.graph.owl import with_class_axioms

PREFIXES = """@prefix : <http://e.org/> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
"""
KITCHEN = """
:Mug rdfs:subClassOf :Vessel,
  [ a owl:Restriction ; owl:onProperty :usedFor ; owl:someValuesFrom :Drinking ] .
:Vessel rdfs:subClassOf :Container,
  [ a owl:Restriction ; owl:onProperty :holds ; owl:someValuesFrom :Liquid ] .
:TeaCup rdfs:subClassOf :Mug .
:mug-1 a :TeaCup .
:Spoon owl:equivalentClass [ a owl:Class ; owl:intersectionOf ( :Tool
  [ a owl:Restriction ; owl:onProperty :hasPart ;
    owl:someValuesFrom [ a owl:Class ; owl:intersectionOf ( :Bowl :Rigid ) ] ] ) ] .
:Tool rdfs:subClassOf [ a owl:Restriction ; owl:onProperty :price ; owl:hasValue 5 ] .
"""
CARDINALITIES = """
:Mug rdfs:subClassOf [ a owl:Restriction ; owl:onProperty :hasPart ; owl:onClass :Handle ;
    owl:qualifiedCardinality 1 ],
  [ a owl:Restriction ; owl:onProperty :holds ; owl:onClass [ a owl:Class ; owl:intersectionOf
    ( :Hot :Liquid ) ] ; owl:minQualifiedCardinality 2 ],
  [ a owl:Restriction ; owl:onProperty :hasPart ; owl:onClass :Lid ; owl:qualifiedCardinality 0 ],
  [ a owl:Restriction ; owl:onProperty :hasPart ; owl:onClass :Cap ;
    owl:minQualifiedCardinality 0 ],
  [ a owl:Restriction ; owl:onProperty :hasPart ; owl:onClass :Foot ;
    owl:maxQualifiedCardinality 1 ],
  [ a owl:Restriction ; owl:onProperty :price ; owl:onDataRange :Number ;
    owl:qualifiedCardinality 1 ] .
"""
NO_FACTS = """
:Pot rdfs:subClassOf [ a owl:Restriction ; owl:onProperty :holds ; owl:allValuesFrom :Soup ],
  [ a owl:Restriction ; owl:onProperty [ owl:inverseOf :in ] ; owl:someValuesFrom :Soup ],
  [ a owl:Class ; owl:unionOf ( :A :B ) ], [ a owl:Class ; owl:complementOf :C ],
  [ a owl:Restriction ; owl:onProperty :has ; owl:minCardinality 2 ],
  [ a owl:Restriction ; owl:onProperty :has ; owl:someValuesFrom [ owl:unionOf ( :A :B ) ] ] .
_:c owl:intersectionOf ( _:c :Pot ) . :Lid rdfs:subClassOf _:c .
"""


def read(tmp_path, text):
    path = tmp_path / "home.owl"
    path.write_text(PREFIXES + text)
    with pytest.warns(DataWarning, match="class axioms of OWL") as caught:
        graph = read_graph(path)
    (warning,) = caught
    local = {
        tuple(name.removeprefix("http://e.org/") for name in triple) for triple in graph
    }
    return graph, local, str(warning.message)


def test_what_axioms_say_is_stated(tmp_path):
    _, local, warning = read(tmp_path, KITCHEN)
    for name in ("Mug", "TeaCup", "mug-1"):
        assert {(name, "usedFor", "Drinking"), (name, "holds", "Liquid")} <= local
    assert ("Vessel", "holds", "Liquid") in local
    assert not any(h in ("Vessel", "Container") and r == "usedFor" for h, r, _ in local)
    assert {("Spoon", "hasPart", "Bowl"), ("Spoon", "hasPart", "Rigid")} <= local
    facts = {
        (h, r) for h, r, _ in local if r in ("usedFor", "holds", "hasPart", "price")
    }
    assert len(facts) == 10
    assert warning.endswith("11 facts follow from class axioms of OWL and were added.")


def test_axioms_that_state_no_fact_are_counted_by_kind(tmp_path):
    _, local, warning = read(tmp_path, NO_FACTS)
    assert not any(relation in ("holds", "has", "in") for _, relation, _ in local)
    kinds = (
        "1 allValuesFrom, 1 circle, 1 complementOf, 1 minCardinality, "
        "2 someValuesFrom, 2 unionOf"
    )
    assert (
        f"0 facts follow from class axioms of OWL and were added; {kinds}"
        in warning.replace("class axioms that state none: ", "")
    )


def test_cardinalities_from_one_on_state_facts(tmp_path):
    _, local, warning = read(tmp_path, CARDINALITIES)
    assert {
        (r, t) for h, r, t in local if h == "Mug" and r in ("hasPart", "holds", "price")
    } == {
        ("hasPart", "Handle"),
        ("holds", "Hot"),
        ("holds", "Liquid"),
    }
    assert "3 facts follow" in warning


def test_other_graphs_stay():
    graph = graph_of([("mug", "usedFor", "drinking"), ("_:x", "isA", "mug")])
    assert with_class_axioms(graph) == (graph, 0, {})
