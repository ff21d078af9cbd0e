"""Damaged graphs: how many triples change, how, and that shares contain each other."""

import pytest

from knowarm.errors import UserError
from knowarm.knowledge.formats import shipped_graph
from knowarm.knowledge.graph.damage import damaged

GRAPH = shipped_graph("objects")
OBJECTS = [name for name in GRAPH.entities if (name, "isLocatedIn", "kitchen") in GRAPH]
STATED = {triple for triple in GRAPH if triple[0] in OBJECTS}
OTHERS = set(GRAPH) - STATED


@pytest.mark.parametrize("kind", ["missing", "wrong", "adversarial"])
def test_a_share_is_damaged_and_all_entities_stay(kind):
    before = set()
    for share in (0.0, 0.1, 0.3, 0.6):
        found = damaged(GRAPH, kind, share, seed=3, objects=OBJECTS)
        assert found.entities == GRAPH.entities
        gone = STATED - set(found)
        assert set(found) >= OTHERS
        if kind == "adversarial":
            assert share * len(STATED) * 0.7 <= len(gone) <= share * len(STATED) + 14
        else:
            assert len(gone) == round(share * len(STATED))
        assert before <= gone
        before = gone
    assert set(damaged(GRAPH, kind, 0.3, seed=4, objects=OBJECTS)) != set(
        damaged(GRAPH, kind, 0.3, seed=3, objects=OBJECTS)
    )


def test_wrong_triples_have_the_same_relations_and_are_new():
    found = damaged(GRAPH, "wrong", 0.4, seed=0, objects=OBJECTS)
    new = set(found) - STATED - OTHERS
    assert len(found) == len(GRAPH)
    assert len(new) == round(0.4 * len(STATED))
    tails = {}
    for _, relation, tail in STATED:
        tails.setdefault(relation, set()).add(tail)
    assert all(tail in tails[relation] for _, relation, tail in new)


def test_adversarial_values_swap_all_their_heads():
    found = damaged(GRAPH, "adversarial", 0.5, seed=1, objects=OBJECTS)

    def heads(graph, relation):
        values = {}
        for head, of, tail in graph:
            if of == relation and head in OBJECTS:
                values.setdefault(tail, set()).add(head)
        return values

    before, after = heads(GRAPH, "usedFor"), heads(found, "usedFor")
    changed = [value for value in before if after.get(value) != before[value]]
    assert changed
    for value in changed:
        assert any(
            after.get(value) == before[other] and after.get(other) == before[value]
            for other in changed
        )


def test_an_unknown_kind_and_a_share_above_one_are_refused():
    with pytest.raises(UserError, match="Unknown kind of damage 'burnt'"):
        damaged(GRAPH, "burnt", 0.1, seed=0, objects=OBJECTS)
    with pytest.raises(UserError, match="between 0 and 1, got 2"):
        damaged(GRAPH, "missing", 2, seed=0, objects=OBJECTS)
