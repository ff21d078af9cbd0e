"""Questions to ontologies: what follows answers, and the evidence says from what."""

from knowarm.asking.answers import answer
from tests.knowledge.ontologies import DISHES, read


def test_questions_follow_the_hierarchy(tmp_path):
    graph, _ = read(tmp_path, DISHES + ":Light owl:disjointWith :Dish .")
    facets = [(name, "red") for name in ("teapot", "bowl", "lamp")]

    def names(text):
        return {name for name, _ in answer(graph, facets, text).evidence}

    assert names("subClassOf Dish") == {"teapot", "bowl"}
    assert names("not subClassOf Dish") == {"lamp"}
    assert names("is dish") == {"teapot", "bowl"}
    assert names("not is dish") == {"lamp"}
    assert names("a dish") == {"teapot", "bowl"}
    assert names("something that is not a dish") == {"lamp"}
    evidence = answer(graph, facets, "subClassOf Dish").evidence["teapot", "red"]
    assert evidence == (
        "Teapot subClassOf Dish because Teapot subClassOf Pot, Pot subClassOf Dish",
    )
    denied = answer(graph, facets, "not subClassOf Dish")
    assert denied.stated.tolist() == [False, False, True]
