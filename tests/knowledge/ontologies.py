"""Small ontologies for tests, in Turtle."""

import warnings

from knowarm.knowledge import read_graph

PREFIXES = """@prefix : <http://e.org/> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix xsd: <http://www.w3.org/2001/XMLSchema#> .
"""
DISHES = """
:Teapot rdfs:subClassOf :Pot . :Pot rdfs:subClassOf :Dish . :Bowl rdfs:subClassOf :Dish .
:Lamp rdfs:subClassOf :Light .
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


def some(relation, value, kind="someValuesFrom"):
    """Return the class of what a restriction demands."""
    return f"[ a owl:Restriction ; owl:onProperty :{relation} ; owl:{kind} {value} ]"


def read(folder, text, name="home.ttl"):
    """Return the graph of a Turtle file, and the warnings of reading it."""
    path = folder / name
    path.write_text(PREFIXES + text)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        graph = read_graph(path)
    return graph, [str(warning.message) for warning in caught]


def local(triples):
    """Return triples by the last parts of their names, as texts."""
    texts = set()
    for triple in triples:
        names = [name.rpartition("/")[2].rpartition("#")[2] for name in triple]
        texts.add(" ".join(names))
    return texts


def derived(graph):
    """Return the triples that were not stated, as texts."""
    return local(graph) - local(graph.stated())
