"""Imports of ontologies: read where a file is at hand, named where none is, fetched never."""

import pytest

from knowarm.errors import UserError
from knowarm.knowledge import read_graph
from knowarm.knowledge.formats import write_graph
from knowarm.knowledge.graph.builder import union
from knowarm.knowledge.graph.edits import edited
from tests.knowledge.ontologies import PREFIXES, derived, local, read

DISHES = "http://other.org/dishes"
IMPORTING = f"""
<http://e.org/home> a owl:Ontology ; owl:imports <{DISHES}> .
:Mug rdfs:subClassOf <{DISHES}#Cup> .
"""
IMPORTED = f"""
<{DISHES}> a owl:Ontology .
<{DISHES}#Cup> rdfs:subClassOf <{DISHES}#Dish> .
"""
CATALOG = """<?xml version="1.0" encoding="UTF-8"?>
<catalog prefer="public" xmlns="urn:oasis:names:tc:entity:xmlns:xml:catalog">
  <group><uri id="1" name="http://other.org/dishes" uri="{uri}"/></group>
</catalog>
"""
RDF_XML = """<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"
  xmlns:rdfs="http://www.w3.org/2000/01/rdf-schema#" {base}>
  <rdf:Description rdf:about="http://other.org/dishes#Cup">
    <rdfs:subClassOf rdf:resource="http://other.org/dishes#Dish"/>
  </rdf:Description>
</rdf:RDF>
"""


def write(folder, name, text):
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(text)


@pytest.mark.parametrize(
    "files",
    [
        {"dishes.ttl": PREFIXES + IMPORTED},
        {"dishes": PREFIXES + IMPORTED},
        {"dishes.owl": RDF_XML.format(base="")},
        {"kitchen-2.ttl": PREFIXES + IMPORTED},
        {"k.owl": RDF_XML.format(base='xml:base="http://other.org/dishes#"')},
        {"k.ttl": "@base <http://other.org/dishes#> .\n" + PREFIXES
         + "<#Cup> rdfs:subClassOf <#Dish> ."},
        {"catalog-v001.xml": CATALOG.format(uri="parts/d%201.ttl"),
         "parts/d 1.ttl": PREFIXES + IMPORTED},
        {"catalog-v001.xml": CATALOG.format(uri="http://other.org/dishes"),
         "dishes.ttl": PREFIXES + IMPORTED},
    ],
    ids=lambda files: " ".join(files),
)  # fmt: skip
def test_what_is_imported_is_read(tmp_path, files):
    for name, text in files.items():
        write(tmp_path, name, text)
    graph, messages = read(tmp_path, IMPORTING)
    assert graph.missing == ()
    assert "Mug subClassOf Dish" in derived(graph)
    assert not any("not at hand" in message for message in messages)


@pytest.mark.parametrize(
    "files",
    [
        {},
        {"other.ttl": PREFIXES + f"<http://e.org/o> owl:imports <{DISHES}> ; a owl:Ontology ."},
        {"notes.md": DISHES},
        {"broken.ttl": f"<{DISHES}> a"},
        {"catalog-v001.xml": CATALOG.format(uri="gone.ttl")},
    ],
    ids=lambda files: " ".join(files),
)  # fmt: skip
def test_what_is_not_at_hand_is_named(tmp_path, files):
    for name, text in files.items():
        write(tmp_path, name, text)
    graph, messages = read(tmp_path, IMPORTING)
    assert graph.missing == (DISHES,)
    (message,) = [message for message in messages if "not at hand" in message]
    assert f"home.ttl: imports {DISHES}, which is not at hand" in message
    changed = edited(graph, ["+ Mug near Pan"])
    assert changed.missing == graph.missing
    assert union(changed, read_graph("household")).missing == graph.missing
    assert graph.stated().missing == graph.missing


@pytest.mark.parametrize(
    "way", ["%2e%2e/secret.ttl", "..%2Fsecret.ttl", "FOLDER/../secret.ttl", "../secret.ttl"]
)  # fmt: skip
def test_no_address_leads_out_of_the_folder(tmp_path, way):
    folder = tmp_path / "downloaded"
    write(tmp_path, "secret.ttl", PREFIXES + ":my :password :hunter2 .")
    address = way.replace("FOLDER", folder.as_uri())
    folder.mkdir()
    text = f"<http://e.org/o> a owl:Ontology ; owl:imports <{address}> ."
    graph, messages = read(folder, text)
    assert not any("hunter2" in tail for _, _, tail in graph)
    assert any("not at hand" in message for message in messages)


def test_circles_of_imports_end_and_files_import_on(tmp_path):
    write(
        tmp_path,
        "a.ttl",
        PREFIXES + "<http://e.org/a> owl:imports <b.ttl> . :A :p :B .",
    )
    write(
        tmp_path,
        "b.ttl",
        PREFIXES + "<http://e.org/b> owl:imports <c.ttl> . :B :p :C .",
    )
    both = "<http://e.org/c> owl:imports <a.ttl>, <c.ttl>, <http://www.w3.org/2002/07/owl> ."
    write(tmp_path, "c.ttl", PREFIXES + both + ":C :p :D .")
    graph = read_graph(tmp_path / "a.ttl")
    assert graph.missing == ()
    facts = {triple for triple in local(graph) if " p " in triple}
    assert facts == {"A p B", "B p C", "C p D"}


def test_blank_nodes_of_two_files_stay_apart(tmp_path):
    write(tmp_path, "dishes.ttl", PREFIXES + "[] :p :a .")
    graph, _ = read(tmp_path, IMPORTING + "[] :p :b .")
    heads = {head for head, relation, _ in graph if relation == "http://e.org/p"}
    assert len(heads) == 2


def test_a_graph_with_its_imports_is_read_again_as_it_is(tmp_path):
    write(tmp_path, "dishes.ttl", PREFIXES + IMPORTED)
    graph, _ = read(tmp_path, IMPORTING)
    (tmp_path / "elsewhere").mkdir()
    path = tmp_path / "elsewhere" / "again.ttl"
    write_graph(graph, path)
    assert read_graph(path) == graph
    assert read_graph(path).missing == ()


def test_an_import_or_catalog_that_is_damaged_is_named(tmp_path):
    write(tmp_path, "dishes.ttl", "<a> <b>")
    with pytest.raises(UserError, match=r"dishes.ttl, line 1: not well-formed"):
        read(tmp_path, IMPORTING)
    write(tmp_path, "catalog-v001.xml", "<catalog>")
    with pytest.raises(
        UserError, match=r"catalog-v001.xml is damaged or of another format"
    ):
        read(tmp_path, IMPORTING)
