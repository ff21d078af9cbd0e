"""Completion by link prediction: what is added, and to what."""

import pytest
import torch

from knowarm.errors import UserError
from knowarm.knowledge.graph.builder import graph_of
from knowarm.knowledge.kge.completion import completed

VESSELS, TOOLS = [f"vessel_{i}" for i in range(8)], [f"tool_{i}" for i in range(8)]
TRUE = [
    (name, relation, f"{kind}_{relation}")
    for names, kind in ((VESSELS, "vessel"), (TOOLS, "tool"))
    for name in names
    for relation in ("usedFor", "hasPart", "isMadeOf", "isLocatedIn")
]


@pytest.mark.parametrize("model", ["analogy", "complex"])
def test_missing_facts_of_two_kinds_of_things_are_found(model):
    missing = {TRUE[0], TRUE[5], TRUE[-2], TRUE[-9]}
    known = graph_of([triple for triple in TRUE if triple not in missing])
    found = set(completed(known, [*VESSELS, *TOOLS], model=model))
    assert found >= set(known)
    added = found - set(known)
    assert len(added & missing) >= 3
    assert len(added - missing) <= 2
    with torch.no_grad():
        again = completed(known, [*VESSELS, *TOOLS], model=model)
    assert set(again) == found


def test_only_facts_about_the_given_objects_are_added():
    known = graph_of([triple for triple in TRUE if triple not in {TRUE[0], TRUE[-2]}])
    added = set(completed(known, VESSELS, model="complex")) - set(known)
    assert TRUE[0] in added
    assert {head for head, _, _ in added} <= set(VESSELS)


def test_an_unknown_model_is_refused():
    with pytest.raises(UserError, match="Unknown graph-embedding model"):
        completed(graph_of(TRUE), VESSELS, model="bert")


def test_without_candidates_nothing_is_added():
    known = graph_of([("mug", "usedFor", "drinking"), *TRUE])
    assert completed(known, ["drinking"], model="complex") == known
