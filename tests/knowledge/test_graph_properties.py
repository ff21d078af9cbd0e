"""Properties that hold for any graph."""

import hypothesis.strategies as st
import pytest
from hypothesis import given, settings

from knowarm.knowledge import KnowledgeGraph, gamma, graph_of, read_graph, sentence
from knowarm.knowledge.formats import write_graph
from knowarm.knowledge.graph.builder import difference, union
from knowarm.knowledge.graph.terms import literal
from tests.thorough import thorough

pytestmark = pytest.mark.usefixtures("unfenced")

WORD = st.text(
    st.characters(
        min_codepoint=32, max_codepoint=0x2FFF, exclude_categories=["Cs", "Cc", "Zl", "Zp"]
    ),
    min_size=1,
    max_size=6,
)  # fmt: skip
PLAIN = st.sampled_from(
    ["mug", "cup", "red", "kitchen", "light_blue", "isA", "a b", "hasColor"]
)
IRI = WORD.map(lambda text: "http://a.org/" + "".join(c for c in text if c.isalnum()))
NAME = st.one_of(PLAIN, IRI, WORD.map(lambda text: "x" + text))
TAIL = st.one_of(
    NAME, WORD.map(literal), WORD.map(lambda text: literal(text, language="en"))
)
TRIPLES = st.lists(st.tuples(NAME, NAME, TAIL), min_size=1, max_size=25)
DIRECTION = st.sampled_from(["out", "in", "both"])
MANY = settings(max_examples=thorough(20, 60), deadline=None)


def facts(graph: KnowledgeGraph) -> set[tuple[str, str, str]]:
    return set(graph)


@MANY
@given(
    TRIPLES,
    st.data(),
    st.integers(0, 3),
    DIRECTION,
    st.one_of(st.none(), st.integers(0, 3)),
)
def test_gamma_is_a_subset_that_holds_what_was_asked(
    triples, data, hops, direction, most
):
    graph = graph_of(triples)
    asked = data.draw(st.lists(st.sampled_from(graph.entities), min_size=1, max_size=3))
    part = gamma(graph, asked, hops=hops, direction=direction, max_degree=most)
    assert facts(part) <= facts(graph)
    assert set(asked) <= set(part.entities)
    assert {name for head, _, tail in part for name in (head, tail)} <= set(
        part.entities
    )


@MANY
@given(
    TRIPLES,
    st.data(),
    st.integers(0, 3),
    DIRECTION,
    st.one_of(st.none(), st.integers(0, 3)),
)
def test_gamma_grows_with_hops(triples, data, hops, direction, most):
    graph = graph_of(triples)
    asked = [data.draw(st.sampled_from(graph.entities))]
    near = gamma(graph, asked, hops=hops, direction=direction, max_degree=most)
    far = gamma(graph, asked, hops=hops + 1, direction=direction, max_degree=most)
    assert facts(near) <= facts(far)
    assert set(near.entities) <= set(far.entities)


@MANY
@given(TRIPLES, st.randoms(use_true_random=False), st.integers(0, 3), DIRECTION)
def test_nothing_depends_on_the_order_of_triples(triples, random, hops, direction):
    shuffled = triples + triples[:3]
    random.shuffle(shuffled)
    first, second = graph_of(triples), graph_of(shuffled)
    assert first == second
    assert list(first) == list(second) == sorted(facts(first))
    asked = [first.entities[0]]
    a, b = (gamma(g, asked, hops=hops, direction=direction) for g in (first, second))
    assert a == b
    if len(a):
        assert sentence(a) == sentence(b)


LABELS = st.dictionaries(NAME, WORD, max_size=3)


@pytest.mark.parametrize("suffix", [".ttl", ".nt", ".jsonld", ".csv", ".tsv"])
@MANY
@given(triples=TRIPLES, labels=LABELS)
def test_reading_what_was_written_gives_the_same_graph(
    tmp_path_factory, suffix, triples, labels
):
    graph = graph_of(triples, labels=labels)
    path = tmp_path_factory.mktemp("graph") / f"graph{suffix}"
    write_graph(graph, path)
    assert read_graph(path) == graph


@MANY
@given(TRIPLES, TRIPLES)
def test_union_and_difference_are_those_of_sets(first, second):
    a, b = graph_of(first), graph_of(second)
    assert facts(union(a, b)) == facts(a) | facts(b)
    assert facts(difference(a, b)) == facts(a) - facts(b)
    assert set(union(a, b).entities) == set(a.entities) | set(b.entities)


@MANY
@given(TRIPLES)
def test_edges_of_an_entity_are_found_in_both_directions(triples):
    graph = graph_of(triples)
    for name in graph.entities:
        entity = graph.entity_id(name)
        out = {(h, r, t) for h, r, t in graph if h == name}
        into = {(h, r, t) for h, r, t in graph if t == name}
        assert facts(gamma(graph, [name], direction="out")) == out
        assert facts(gamma(graph, [name], direction="in")) == into
        assert len(graph.tails[graph.out_rows(entity)]) == len(out)
    assert all(triple in graph for triple in triples)
    assert ("not", "in", "it") not in graph
