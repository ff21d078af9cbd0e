import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.knowledge import graph_of
from knowarm.knowledge.formats import shipped_graph
from knowarm.knowledge.queries.queries import QueryGraph, parse_query
from knowarm.knowledge.queries.sparql import sparql
from knowarm.questions import Condition
from tests.knowledge.choice import CHOICE, COLOURS, OBJECTS

GRAPH = graph_of(
    [
        ("mug", "usedFor", "drinking"),
        ("mug", "hasPart", "handle"),
        ("glass", "usedFor", "drinking"),
        ("glass", "isMadeOf", "glass"),
        ("pan", "usedFor", "salt and pepper"),
        ("pan", "hasPart", "handle"),
        ("pan", "next to", "mug"),
        ("drinking", "relatedTo", "water"),
    ]
)
FACETS = [("mug", "red"), ("mug", "blue"), ("glass", "blue"), ("pan", "red")]


@pytest.fixture
def asked():
    return QueryGraph(GRAPH, FACETS)


@pytest.fixture(scope="module")
def shipped():
    return QueryGraph(shipped_graph("objects"), CHOICE)


def names(queries):
    return [query.name for query in queries]


def test_conditions_are_the_facts_of_objects_and_the_colours(asked):
    """Neither facts about values nor the names of objects can be asked."""
    assert [each.name for each in asked.conditions] == [
        "hasPart handle",
        "usedFor drinking",
        "usedFor salt and pepper",
        "hasColor blue",
        "hasColor red",
    ]


def test_facts_are_answered_by_the_object_and_colours_by_the_facet(asked):
    queries = [parse_query(text) for text in ("hasPart handle", "hasColor blue")]
    assert asked.answers(queries).tolist() == [
        [True, True, False, True],
        [False, True, True, False],
    ]
    both = parse_query("usedFor drinking and hasColor blue")
    assert asked.answers([both]).tolist() == [[False, True, True, False]]


def test_queries_of_two_conditions_need_both(asked):
    """All that is used for drinking and blue is also what is blue, so that is no new question."""
    assert names(asked.queries("none")) == [each.name for each in asked.conditions]
    pairs = names(asked.queries("colour"))[5:]
    assert pairs == [
        "hasPart handle and hasColor blue",
        "usedFor drinking and hasColor red",
    ]
    every = names(asked.queries("all"))[5:]
    assert set(every) - set(pairs) == {"hasPart handle and usedFor drinking"}


@pytest.mark.parametrize(
    "text", ["usedFor salt and pepper", "usedFor salt and pepper and hasColor red"]
)
def test_a_value_may_hold_the_word_and(text):
    assert parse_query(text).name == text
    assert parse_query(text).conditions[0] == Condition("usedFor", "salt and pepper")


@pytest.mark.parametrize("text", ["usedFor", "", "usedFor "])
def test_a_query_without_a_value_is_refused(text):
    with pytest.raises(UserError, match="needs a relation and a value"):
        parse_query(text)


def test_bad_graphs_are_refused():
    with pytest.raises(UserError, match=r"says nothing about the object 'mugg'.*'mug'"):
        QueryGraph(GRAPH, [("mugg", "red")])
    with pytest.raises(UserError, match="no facets"):
        QueryGraph(GRAPH, [])
    same = graph_of([("a", "usedFor", "x"), ("b", "usedFor", "x")])
    with pytest.raises(UserError, match="no fact that tells a, b apart"):
        QueryGraph(same, [("a", "red"), ("b", "red")]).queries()


def test_the_graph_may_state_which_colours_an_object_has():
    graph = graph_of([("mug", "hasColor", "red"), ("pan", "usedFor", "soup")])
    asked = QueryGraph(graph, [("mug", "red"), ("mug", "blue"), ("pan", "blue")])
    assert asked.possible().tolist() == [True, False, True]
    with pytest.raises(UserError, match=r"'mug' the colours red.* in blue only"):
        QueryGraph(graph, [("mug", "blue")]).possible()


def test_answers_of_the_shipped_graph_are_those_of_sparql(shipped):
    single = shipped.queries("none")
    for query, row in zip(single, shipped.answers(single), strict=True):
        (condition,) = query.conditions
        found = {shipped.facets[i] for i in np.flatnonzero(row)}
        if condition.is_seen:
            assert found == {facet for facet in CHOICE if facet[1] == condition.value}
            continue
        text = f"SELECT ?x WHERE {{ ?x :{condition.relation} :{condition.value} }}"
        holders = {name for (name,) in sparql(shipped.graph, text).rows} & set(OBJECTS)
        assert found == {(name, colour) for name in holders for colour in COLOURS}, (
            condition
        )


def test_the_shipped_graph_has_something_to_ask_about_every_object(shipped):
    single = shipped.queries("none")
    assert len(single) == 49
    facts = shipped.answers([q for q in single if not q.conditions[0].is_seen])
    assert facts.any(1).all()
    assert (facts.sum(0) >= 2).all()
    assert all(
        shipped.answers([query]).sum() >= 2 * len(COLOURS) for query in single[:40]
    )
    assert all(parse_query(query.name) == query for query in shipped.queries("all"))


def test_relations_of_two_namespaces_are_told_apart():
    graph = graph_of(
        [("mug", "http://a/usedFor", "tea"), ("pan", "http://b/usedFor", "soup")]
    )
    asked = QueryGraph(graph, [("mug", "red"), ("pan", "red")])
    names = [query.name for query in asked.queries()]
    assert names == ["http://a/usedFor tea", "http://b/usedFor soup"]
    assert asked.answers(asked.queries()).tolist() == [[True, False], [False, True]]


def test_doubtful_facts_answer_as_probably_as_one_of_them_holds():
    facts = {("mug", "usedFor", "drinking"): 0.9, ("mug", "holds", "tea"): 0.5}
    other = [
        ("can", "usedFor", "drinking"),
        ("jar", "holds", "tea"),
        ("can", "holds", '"tea"'),
    ]
    graph = graph_of([*facts, ("mug", "holds", '"tea"'), *other], confidence=facts)
    graph = graph_of(graph, confidence=facts | {("mug", "holds", '"tea"'): 0.2})
    asked = QueryGraph(graph, [("mug", "red"), ("can", "red"), ("jar", "blue")])
    names = ["usedFor drinking", "holds tea", "holds tea and hasColor red",
             "usedFor drinking and holds tea"]  # fmt: skip
    degrees = asked.degrees([parse_query(name) for name in names])
    expected = [[0.9, 1, 0], [0.6, 1, 1], [0.6, 1, 0], [0.54, 1, 0]]
    np.testing.assert_allclose(degrees, expected, rtol=1e-6)
    np.testing.assert_array_equal(
        asked.answers([parse_query(name) for name in names]), degrees > 0
    )
