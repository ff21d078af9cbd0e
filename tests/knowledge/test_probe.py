import json

import numpy as np
import pytest

from knowarm.experiment.agents import AGENTS
from knowarm.knowledge.formats import shipped_graph
from knowarm.knowledge.probe import _predict, _share_found, probe, query_agreement
from knowarm.knowledge.queries.queries import QueryGraph
from tests.knowledge.choice import CHOICE
from tests.knowledge.helpers import KNOWLEDGE


def test_full_plus_keeps_object_and_colour(facets):
    found = probe(KNOWLEDGE["full+"], facets)
    assert found.largest < 0.9
    assert found.nearly_same == []
    assert found.recovered["object"]["task"] == 1.0
    assert found.recovered["colour"]["task"] == 1.0
    assert found.recovered["object"]["all"] == 1.0
    assert found.recovered["colour"]["all"] == 1.0
    assert found.recovered["colour"]["guess"] < 0.2


def test_the_papers_full_loses_the_colour(facets):
    found = probe(KNOWLEDGE["full"], facets)
    pairs = {(a, b) for a, b, _ in found.nearly_same}
    assert ("red mug", "blue mug") in pairs
    assert found.largest > 0.99
    assert found.recovered["object"]["task"] == 1.0
    assert found.recovered["colour"]["task"] < 0.5
    json.dumps(found.describe())


def test_partial_and_placebos(facets):
    partial = probe(KNOWLEDGE["partial"], facets)
    assert "colour" not in partial.recovered
    assert "isMadeOf" in partial.recovered
    placebo = probe(KNOWLEDGE["zeros"], facets)
    assert placebo.recovered == {}
    assert np.isnan(placebo.cosine).all()
    json.dumps(placebo.describe(), allow_nan=False)
    onehot = probe(KNOWLEDGE["onehot"], facets)
    np.testing.assert_allclose(onehot.cosine, np.eye(6), atol=1e-12)


def test_the_probe_beats_guessing_the_material(facets):
    real = probe(KNOWLEDGE["partial"], facets)
    assert real.recovered["isMadeOf"]["all"] > real.recovered["isMadeOf"]["guess"]


def test_ridge_by_hand():
    vectors = np.array([[1.0], [-1.0], [3.0]])
    targets = np.array([[1.0], [0.0], [0.0]])
    held = np.array([False, False, True])
    # centred at 0 and .5: weight = x'y / (x'x + ridge) = 1 / (2 + .01)
    assert _predict(vectors, targets, held)[0, 0] == pytest.approx(0.5 + 3 / 2.01)


def test_share_found():
    assert _share_found(np.array([0.9, 0.1, 0.5]), np.array([1.0, 1.0, 0.0])) == 0.5
    assert _share_found(np.array([0.9, 0.1, 0.5]), np.array([1.0, 0.0, 1.0])) == 1.0


def test_slots_of_zeros_agree_with_nothing():
    asked = QueryGraph(shipped_graph("objects"), CHOICE)
    assert query_agreement(AGENTS["query-zeros"].knows, asked) is None
