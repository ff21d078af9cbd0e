"""Minimal pairs of questions of the choose task: every edit does to the answers what it says."""

import numpy as np
import pytest

from knowarm.knowledge import graph_of
from knowarm.knowledge.formats import shipped_graph
from knowarm.knowledge.graph.builder import with_triples
from knowarm.knowledge.graph.terms import local_name
from knowarm.knowledge.queries.minimal_pairs import MinimalPair, Question
from knowarm.knowledge.queries.queries import QueryGraph, parse_query

GRAPH = shipped_graph("objects")
COLOURS = ("red", "blue", "green")
NAMES = sorted({head for head, relation, _ in GRAPH if "isLocatedIn" in relation})
OBJECTS = [name.rpartition(":")[2] for name in NAMES]
QUERIES = [
    query
    for query in QueryGraph(GRAPH, [(name, COLOURS[0]) for name in OBJECTS]).queries(
        "all"
    )
    if not all(condition.is_seen for condition in query.conditions)
]


def questions(seed, count):
    """Draw questions among four objects of which one answers."""
    rng = np.random.default_rng(seed)
    while count:
        visible = rng.permutation(OBJECTS)[:4].tolist()
        facets = [(name, str(rng.choice(COLOURS))) for name in visible]
        query = QUERIES[rng.integers(len(QUERIES))]
        answers = np.flatnonzero(QueryGraph(GRAPH, facets).answers([query])[0])
        if len(answers) != 1:
            continue
        count -= 1
        facets.insert(0, facets.pop(int(answers[0])))
        others = [name for name in OBJECTS if name not in visible]
        yield Question(GRAPH, query, facets, others), rng


def answers_of(question, graph):
    """Return the visible objects that answer, computed from the triples alone."""
    triples = {tuple(name.rpartition(":")[2] for name in triple) for triple in graph}
    names = []
    for name, colour in question.facets:
        conditions = question.query.conditions
        holds = [
            part.value == colour
            if part.relation == "hasColor"
            else (name, *part) in triples
            for part in conditions
        ]
        if all(holds):
            names.append(name)
    return names


@pytest.mark.parametrize("seed", range(4))
def test_edits_do_what_they_say(seed):
    pairs = 0
    for question, rng in questions(seed, 12):
        pair = question.minimal_pair(rng)
        if pair is None:
            continue
        pairs += 1
        right = question.facets[0][0]
        heir = question.facets[pair.heir][0]
        expected = {"deciding": [heir], "placebo": [right], "removal": []}
        assert pair.edits.keys() == expected.keys()
        for kind, answers in expected.items():
            edited = pair.edits[kind].apply(GRAPH)
            assert answers_of(question, edited) == answers
            changed = set(edited) ^ set(GRAPH)
            assert len(changed) == (1 if kind == "removal" else 2)
    assert pairs > 3


def test_the_placebo_is_matched_in_relation_and_value_and_is_out_of_sight():
    found = 0
    for question, rng in questions(9, 12):
        pair = question.minimal_pair(rng)
        if pair is None:
            continue
        found += 1
        old, new = pair.edits["placebo"]
        assert old[1:] == new[1:] == pair.fact[1:]
        seen = {name for name, _ in question.facets}
        moved = {name.rpartition(":")[2] for name in (old[0], new[0])}
        assert moved.isdisjoint(seen)
        assert old in GRAPH
        assert new not in GRAPH
    assert found > 3


def test_objects_of_the_placebo_have_as_many_triples_where_there_are_such():
    """Of two objects that could lose the fact it takes the one with as many triples."""
    facts = [("a", "usedFor", "x"), ("b", "madeOf", "z")]
    facts += [
        ("like", "usedFor", "x"),
        ("rich", "usedFor", "x"),
        ("free", "madeOf", "z"),
    ]
    facts += [("rich", "contains", f"v{i}") for i in range(9)]
    facets = [("a", "red"), ("b", "red")]
    others = ["rich", "like", "free"]
    question = Question(graph_of(facts), parse_query("usedFor x"), facets, others)
    for seed in range(8):
        pair = question.minimal_pair(np.random.default_rng(seed))
        old, new = pair.edits["placebo"]
        assert (old[0], new[0]) == ("like", "free")


def test_what_cannot_be_edited_has_no_pair():
    facts = [("a", "usedFor", "x"), ("c", "usedFor", "x"), ("d", "madeOf", "z")]
    facts += [("b", "madeOf", "z")]
    graph, rng = graph_of(facts), np.random.default_rng(0)

    def pair(text, others, *facets):
        return Question(graph, parse_query(text), facets, others).minimal_pair(rng)

    visible = (("a", "red"), ("b", "red"))
    assert pair("usedFor x", ["c", "d"], *visible) is not None
    assert pair("hasColor red", ["c", "d"], ("a", "red"), ("b", "blue")) is None
    other_colour = (("a", "red"), ("b", "blue"))
    assert pair("usedFor x and hasColor red", ["c", "d"], *other_colour) is None
    assert pair("usedFor x", ["d"], *visible) is None  # nothing to move out of sight
    assert pair("usedFor x", ["c"], *visible) is None  # nothing to move it to


SUBPROPERTY = "http://www.w3.org/2000/01/rdf-schema#subPropertyOf"


@pytest.mark.parametrize(
    ("more", "has_pair"),
    [
        ([("a", "part", "x")], True),
        ([("a", "subPart", "x")], False),
        ([("a", "part", "x"), ("a", "subPart", "x")], False),
    ],
)
def test_a_fact_that_follows_from_others_has_no_pair(more, has_pair):
    """With the triple gone the object would still answer."""
    facts = [("c", "part", "x"), ("b", "near", "y"), ("d", "near", "y"), *more]
    facts.append(("subPart", SUBPROPERTY, "part"))
    graph = with_triples(graph_of(facts), facts)  # adds what follows
    facets = (("a", "red"), ("b", "red"))
    question = Question(graph, parse_query("part x"), facets, ["c", "d"])
    assert QueryGraph(graph, facets).answers([question.query])[0].tolist() == [
        True,
        False,
    ]
    pair = question.minimal_pair(np.random.default_rng(0))
    assert (pair is not None) == has_pair


def test_facts_that_an_image_shows_are_told_from_others():
    def is_shown(relation):
        return MinimalPair(("urn:x:a", f"urn:x:{relation}", "v"), 1, {}).is_shown

    used = {local_name(name) for name in GRAPH.relations_used}
    assert set(filter(is_shown, used)) == {"hasShape", "hasPart"}
    assert not any(map(is_shown, ("usedFor", "isMadeOf", "isLocatedIn", "ownedBy")))
