"""A user's graph, in a namespace of its own, all the way to a vector and its probe."""

import pytest

from knowarm.errors import UserError
from knowarm.knowledge import KnowledgeConfig, graph_of, read_graph, scene_embedding
from knowarm.knowledge.probe import probe
from knowarm.knowledge.slots import graph_facets

TURTLE = """
@prefix home: <http://example.org/home#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
home:Mug01 rdfs:label "mug" ; home:paint home:Red, home:Blue ; home:madeOf home:Ceramic .
home:Bowl rdfs:label "bowl" ; home:paint home:Red ; home:madeOf home:Ceramic .
home:Spoon home:paint home:Silver ; home:madeOf home:Steel .
home:Fork home:paint home:Silver, home:Blue ; home:madeOf home:Steel .
home:Shelf home:madeOf home:Wood .
"""


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "home.ttl"
    path.write_text(TURTLE)
    return path


def test_names_of_the_task_find_their_iris(path):
    config = KnowledgeConfig(detail="full", graph=str(path), colour_relation="paint")
    embedding = scene_embedding(
        config, [("mug", "red"), ("mug", "blue"), ("Fork", "Silver")]
    )
    assert embedding.dim == 150
    assert embedding.sentences[0] == "mug made of ceramic mug paint red"
    named = KnowledgeConfig(
        detail="full", graph=str(path), colour_relation="paint",
        entity_names={"cup": "Mug01", "crimson": "Red"},
    )  # fmt: skip
    assert (
        scene_embedding(named, [("cup", "crimson")]).vector == embedding.matrix[0]
    ).all()
    assert scene_embedding(named, [("cup", "crimson")]).slots[0].name == "crimson cup"


def test_facets_of_any_object_come_from_the_graph(path):
    graph = read_graph(path)
    assert graph_facets(["mug"], graph, "paint") == [("mug", "Blue"), ("mug", "Red")]
    facets = graph_facets(["Fork", "Bowl"], graph, "paint")
    assert facets == [("Fork", "Blue"), ("Fork", "Silver"), ("Bowl", "Red")]
    shelf = graph_facets(["Shelf"], graph, "paint")
    config = KnowledgeConfig(detail="full", graph=str(path), colour_relation="paint")
    with pytest.raises(
        UserError, match="'Shelf' has no colour in the graph, or none that hops"
    ):
        scene_embedding(config, shelf)


def test_a_small_graph_can_be_probed(path):
    config = KnowledgeConfig(detail="full", graph=str(path), colour_relation="paint")
    found = probe(config, [("mug", "red"), ("mug", "blue")])
    assert set(found.recovered["colour"]) == {"task", "all", "guess"}
    with pytest.raises(UserError, match=r"colour relation 'hasColor'.*colour_relation"):
        scene_embedding(
            KnowledgeConfig(detail="full", graph=str(path)), [("mug", "red")]
        )


def test_an_unknown_entity_of_a_large_graph():
    graph = graph_of((f"thing{i}", "r", "hub") for i in range(25_000))
    with pytest.raises(
        UserError, match=r"Unknown entity 'thing2500x'.*Did you mean 'thing2500"
    ):
        graph.entity_id("thing2500x")
