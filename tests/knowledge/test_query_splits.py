import hashlib
import json
from itertools import combinations

import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.knowledge import graph_of
from knowarm.knowledge.formats import shipped_graph
from knowarm.knowledge.graph.builder import difference, union
from knowarm.knowledge.graph.edits import edited
from knowarm.knowledge.queries.splits import SEEDS, query_splits
from knowarm.questions import Query
from tests.knowledge.choice import CHOICE, OBJECTS

GRAPH = shipped_graph("objects")


@pytest.fixture(scope="module", params=[0, 1])
def splits(request):
    return query_splits(GRAPH, CHOICE, seed=request.param)


def questions(table):
    """Return every (query, object) that a table asks."""
    return {
        (table.queries[q], table.facets[f][0])
        for q, f in np.argwhere(table.askable).tolist()
    }


def conditions_of(pairs):
    return {(c, name) for query, name in pairs for c in query.conditions}


def test_every_table_has_enough_distractors(splits):
    assert set(splits.tests) == {"S1", "S2", "S3", "S4", "S5"}
    for table in (splits.train, *splits.tests.values()):
        table.check_objects(4)


def test_tests_ask_what_training_does_not(splits):
    train = questions(splits.train)
    assert questions(splits.test("S1")) == train
    for name in ("S2", "S3", "S4"):
        assert not questions(splits.test(name)) & train, name
    changed = splits.test("S5")
    before = dict(zip(splits.train.queries, splits.train.satisfies, strict=True))
    for query, facet in np.argwhere(changed.askable):
        assert not before[changed.queries[query]][facet]


def test_s2_pairs_are_new_though_both_parts_are_known(splits):
    train = conditions_of(questions(splits.train))
    for query, name in questions(splits.test("S2")):
        parts = query.conditions
        assert any((c, name) not in train for c in parts)
        assert all(any(c == known for known, _ in train) for c in parts)
        assert any(name == known for _, known in train)


def test_s3_objects_are_new_and_their_conditions_known(splits):
    train = splits.train
    shown = {train.facets[f][0] for f in np.flatnonzero(train.shown)}
    asked = {c for c, _ in conditions_of(questions(train))}
    held = splits.held_out.objects
    assert len(held) == 6
    assert not held & shown
    test = splits.test("S3")
    assert {test.facets[f][0] for f in np.flatnonzero(test.shown)} == held
    assert {name for _, name in questions(test)} == held
    assert {c for c, _ in conditions_of(questions(test))} <= asked


def test_s4_values_are_new_and_linked_to_values_of_training(splits):
    train = {c.value for c, _ in conditions_of(questions(splits.train))}
    links = {frozenset((head, tail)) for head, _, tail in GRAPH}
    held = splits.held_out.values
    assert held
    assert not held & train
    assert all(
        any(frozenset((value, known)) in links for known in train) for value in held
    )
    for query, _ in questions(splits.test("S4")):
        assert {c.value for c in query.conditions} & held


def test_s5_asks_queries_of_training_whose_answer_changed(splits):
    asked = {c for c, _ in conditions_of(questions(splits.train))}
    test = splits.test("S5")
    assert {c for c, _ in conditions_of(questions(test))} <= asked
    single = [
        q
        for q in np.flatnonzero(test.askable.any(1))
        if len(test.queries[q].conditions) == 1
    ]
    assert len(single) >= 4
    before = dict(zip(splits.train.queries, splits.train.satisfies, strict=True))
    for query in single:
        old = before[test.queries[query]] & test.shown
        new = np.flatnonzero(test.askable[query])
        assert not (test.satisfies[query] & old).any()
        assert test.related[new][:, old].any(1).all(), (
            "the old answer may stand beside the new"
        )


def test_what_is_shown_is_asked_for(splits):
    """A facet that is never a target would tell, without any query, that it is a distractor."""
    for table in (splits.train, *(splits.test(name) for name in ("S2", "S3", "S4"))):
        assert (table.askable.any(0) == table.shown).all()


def test_guessing_without_the_query_is_chance(splits):
    """Draw sets of objects that can all be asked for: no object stands out as the target.

    An object's share as the target, learned on half of the layouts, is used on the other half.
    """
    rng = np.random.default_rng(3)
    for table in (splits.train, splits.test("S3")):
        facets = np.flatnonzero(table.shown)
        owner = np.array([OBJECTS.index(name) for name, _ in table.facets])
        scenes = []
        while len(scenes) < 400:
            scene = rng.choice(facets, 4, replace=False)
            if len(set(owner[scene])) < 4:
                continue
            alone = table.satisfies[:, scene].sum(1) == 1
            if (table.askable[:, scene] & alone[:, None]).any(0).all():
                scenes.append(scene)
        scenes, target = np.array(scenes), rng.integers(4, size=len(scenes))
        chosen = np.bincount(
            owner[scenes[np.arange(200), target[:200]]], minlength=len(OBJECTS)
        )
        seen = np.bincount(owner[scenes[:200]].ravel(), minlength=len(OBJECTS))
        liking = chosen / np.maximum(seen, 1)
        guess = liking[owner[scenes[200:]]].argmax(1)
        assert abs((guess == target[200:]).mean() - 0.25) < 0.1


def test_the_same_seed_gives_the_same_tables_and_another_one_others():
    one, same, other = (query_splits(GRAPH, CHOICE, seed=seed) for seed in (4, 4, 5))
    for name in one.tests:
        assert (one.test(name).askable == same.test(name).askable).all()
        assert one.test(name).queries == same.test(name).queries
    assert one.held_out.objects != other.held_out.objects
    assert one.held_out.values != other.held_out.values
    assert one.held_out.pairs != other.held_out.pairs


DRAWS = {
    "published": "10208f457e8e74b4",
    "validation": "f145d54e7dc80576",
    "test": "31b22a1ae0fc0a56",
}
"""Digest of what each declared draw holds out and edits."""


def digest(draw):
    """Digest what a draw holds out and edits."""
    held = draw.held_out
    text = json.dumps(
        [
            {split: sorted(names) for split, names in sorted(held.new.items())},
            sorted(held.values),
            sorted((condition.name, name) for condition, name in held.pairs),
            sorted(set(draw.edited) ^ set(GRAPH)),
        ]
    )
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@pytest.fixture(scope="module")
def declared():
    return {
        name: query_splits(GRAPH, CHOICE, seed=seed) for name, seed in SEEDS.items()
    }


def test_the_declared_draws_are_what_they_were(declared):
    assert {name: digest(draw) for name, draw in declared.items()} == DRAWS


def test_no_declared_draw_tests_what_another_one_tests(declared):
    for draw in declared.values():
        assert set(draw.tests) == {"S1", "S2", "S3", "S4", "S5"}
        assert len(draw.held_out.objects) == len(draw.held_out.values) == 6
        assert len(draw.held_out.pairs) > 60
        assert len(draw.held_out.swapped) == 8
    for one, other in combinations(declared.values(), 2):
        for what in ("objects", "values", "pairs", "swapped"):
            both = getattr(one.held_out, what) & getattr(other.held_out, what)
            assert not both, what
        for name in ("S2", "S3", "S4", "S5"):
            assert not questions(one.test(name)) & questions(other.test(name)), name


def test_a_seed_that_is_not_declared_leaves_nothing_alone(declared):
    assert query_splits(GRAPH, CHOICE, seed=8).held_out.earlier == ()
    assert [len(draw.held_out.earlier) for draw in declared.values()] == [0, 1, 2]


def test_what_is_held_out_does_not_depend_on_the_order_of_the_facets():
    one, other = (
        query_splits(GRAPH, facets).held_out for facets in (CHOICE, CHOICE[::-1])
    )
    assert (one.objects, one.values, one.pairs) == (
        other.objects,
        other.values,
        other.pairs,
    )


def test_splits_draw_from_streams_of_their_own():
    """Holding out less leaves the other draws as they are."""
    objects = query_splits(GRAPH, CHOICE, hold_out=["S3"])
    assert objects.held_out.objects == query_splits(GRAPH, CHOICE).held_out.objects
    assert objects.held_out.values == set()
    assert set(objects.tests) == {"S1", "S3", "S5"}
    with pytest.raises(UserError, match=r"S4 .* is empty: hold_out does not name it"):
        objects.test("S4")


def test_an_edited_graph_of_the_user_is_a_test():
    old = graph_of(
        [("toolbox", "usedFor", "repairing"), ("mallet", "usedFor", "repairing")]
    )
    new = graph_of(
        [("mug", "usedFor", "repairing"), ("mug", "usedFor", "sorting screws")]
    )
    splits = query_splits(
        GRAPH, CHOICE, hold_out=[], edited=union(difference(GRAPH, old), new)
    )
    asked = questions(splits.test("S5"))
    assert (Query.of(("usedFor", "repairing")), "mug") in asked
    assert {name for _, name in asked} == {"mug"}
    assert Query.of(("usedFor", "sorting screws")) in splits.test("S5").queries
    assert (
        splits.test("S5").queries[: len(splits.train.queries)] == splits.train.queries
    )
    unchanged = query_splits(GRAPH, CHOICE, edited=GRAPH)
    with pytest.raises(
        UserError, match=r"S5 .* is empty: the edited graph gives no query"
    ):
        unchanged.test("S5")


def test_edits_keep_the_labels_of_what_loses_its_last_triple():
    uses = {"mug": "Q1", "jug": "Q1", "lamp": "Q2", "book": "Q3"}
    triples = [(name, "usedFor", f"http://e.org/{use}") for name, use in uses.items()]
    words = {"Q1": "drinking", "Q2": "lighting", "Q3": "reading"}
    labels = {f"http://e.org/{use}": word for use, word in words.items()}
    graph = graph_of(triples, labels=labels)
    facets = [(name, colour) for name in uses for colour in ("red", "blue")]
    split = query_splits(graph, facets, hold_out=(), objects=3)
    assert set(split.edited) != set(graph)
    assert split.edited.own_labels() == labels
    changed = edited(graph, ["- lamp usedFor lighting", "+ book usedFor lighting"])
    assert ("book", "usedFor", "http://e.org/Q2") in changed


def test_splits_that_a_graph_does_not_allow_say_why():
    graph = graph_of(
        [(name, "usedFor", use) for name, use in zip("abcdef", "uuvvww", strict=True)]
    )
    facets = [
        (name, colour) for name in "abcdef" for colour in ("red", "blue", "green")
    ]
    splits = query_splits(graph, facets)
    assert set(splits.tests) >= {"S1", "S5"}
    with pytest.raises(UserError, match=r"S3 .* is empty: 5 of the 6 objects"):
        splits.test("S3")
    with pytest.raises(
        UserError,
        match=r"S4 .* is empty: of the objects whose values can be held out, 0",
    ):
        splits.test("S4")
    with pytest.raises(UserError, match="Unknown split 's3'"):
        splits.test("s3")
    with pytest.raises(UserError, match="Unknown split to hold out 'S1'"):
        query_splits(graph, facets, hold_out=["S1"])
    with pytest.raises(UserError, match="Training would ask nothing"):
        query_splits(graph, facets[:6])
