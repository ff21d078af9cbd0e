import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.knowledge import gamma, graph_of, household, sentence
from knowarm.knowledge.graph.homonyms import best_described

CHAIN = graph_of(
    [
        ("mug", "hasColor", "red"),
        ("tomato", "hasColor", "red"),
        ("red", "isA", "color"),
        ("mug", "isA", "cup"),
        ("cup", "isA", "container"),
        ("container", "isA", "object"),
        ("kitchen", "holds", "mug"),
        ("kitchen", "holds", "tomato"),
    ]
)


def test_one_hop_is_the_papers():
    assert set(gamma(CHAIN, ["mug"])) == {
        ("mug", "hasColor", "red"),
        ("mug", "isA", "cup"),
    }
    assert gamma(CHAIN, ["mug"]).entities == ["cup", "mug", "red"]


def test_directions():
    assert set(gamma(CHAIN, ["mug"], direction="in")) == {("kitchen", "holds", "mug")}
    assert len(gamma(CHAIN, ["mug"], direction="both")) == 3


def test_it_never_comes_back_through_an_attribute():
    for direction in ("out", "in", "both"):
        part = gamma(CHAIN, ["mug"], hops=5, direction=direction)
        assert "tomato" not in part.entities


def test_hops():
    assert "container" in gamma(CHAIN, ["mug"], hops=2).entities
    assert "object" not in gamma(CHAIN, ["mug"], hops=2).entities
    assert "object" in gamma(CHAIN, ["mug"], hops=3).entities
    alone = gamma(CHAIN, ["mug"], hops=0)
    assert len(alone) == 0
    assert alone.entities == ["mug"]


def test_relations_and_degree_guard():
    assert set(gamma(CHAIN, ["mug"], relations=["isA"], hops=2)) == {
        ("mug", "isA", "cup"),
        ("cup", "isA", "container"),
    }
    hub = graph_of([("a", "r", "hub")] + [("hub", "r", f"x{i}") for i in range(5)])
    assert len(gamma(hub, ["a"], hops=2)) == 6
    assert len(gamma(hub, ["a"], hops=2, max_degree=4)) == 1
    # What was asked for is always expanded
    assert len(gamma(hub, ["hub"], max_degree=4)) == 5


def test_cycles_end():
    ring = graph_of(
        [("a", "isA", "b"), ("b", "isA", "c"), ("c", "isA", "a"), ("a", "isA", "a")]
    )
    assert set(gamma(ring, ["a"], hops=50, direction="both")) == set(ring)


def test_a_subgraph_is_a_graph():
    part = gamma(household(), ["mug", "bottle"], hops=2)
    again = gamma(part, ["mug"])
    assert again == gamma(household(), ["mug"])
    assert np.all(np.diff(part.heads) >= 0)


def test_bad_requests():
    with pytest.raises(UserError, match=r"Unknown entity 'bottel'.*'bottle'"):
        gamma(household(), ["bottel"])
    with pytest.raises(UserError, match=r"Unknown relation 'hasColour'.*'hasColor'"):
        gamma(household(), ["mug"], relations=["hasColour"])
    with pytest.raises(UserError, match="hops is -1"):
        gamma(household(), ["mug"], hops=-1)
    with pytest.raises(UserError, match="direction 'up'"):
        gamma(household(), ["mug"], direction="up")
    with pytest.raises(UserError, match=r"subgraph of mug is empty.*direction='both'"):
        sentence(gamma(household(), ["mug"], relations=["needs"]))


def test_a_name_means_what_the_subgraph_describes():
    triples = [("Mug", "usedFor", "tea"), ("Mug", "usedFor", "milk")]
    graph = graph_of([*triples, ("mug", "usedFor", "tea")])
    assert graph.names.at(best_described(graph, "mug")) == ["Mug"]
    part = gamma(graph, ["mug"])
    assert part.names.at(best_described(part, "mug")) == ["mug"]
