"""Link prediction on splits of a graph, and of OpenKE's folders."""

import json
import sys

import numpy as np
import pytest
import torch

from benchmarks import link_prediction
from benchmarks.apartment_graph import write_openke
from benchmarks.triple_splits import read_split, split_graph
from knowarm.errors import UserError
from knowarm.knowledge import graph_of, household, read_graph
from knowarm.knowledge.kge import KgeConfig
from knowarm.knowledge.kge.models import MODELS
from knowarm.knowledge.kge.train import new_model


@pytest.fixture
def own_models(monkeypatch):
    """The benchmark's own models, registered for one test."""
    for name, kind in link_prediction.OWN_MODELS.items():
        monkeypatch.setitem(MODELS, name, kind)


PARTS = ("train", "valid", "test")


def test_a_split_keeps_every_name_in_training():
    split = split_graph(household(), valid=0.1, test=0.2, seed=1)
    triples = household().triples
    assert len(split.train) + len(split.valid) + len(split.test) == len(triples)
    assert len(split.test) == pytest.approx(2 * len(split.valid), abs=2)
    assert len(np.unique(split.everything, axis=0)) == len(triples)
    assert set(split.train[:, [0, 2]].ravel()) == set(range(split.entities))


def test_openke_keeps_its_split(tmp_path):
    split = split_graph(household())
    write_openke(split, tmp_path)
    back = read_split(tmp_path)
    assert back.graph == graph_of(household())
    assert read_graph(tmp_path) == back.graph
    for part in PARTS:
        ours, theirs = getattr(split, part), getattr(back, part)
        assert sorted(map(tuple, ours)) == sorted(map(tuple, theirs))


def test_a_triple_in_two_parts_is_no_split(tmp_path):
    (tmp_path / "train.txt").write_text("mug\tusedFor\tdrinking\n")
    (tmp_path / "test.txt").write_text("mug\tusedFor\tdrinking\n")
    with pytest.raises(
        UserError, match="the triple mug usedFor drinking is in several of train"
    ):
        read_split(tmp_path)


def test_measures_by_hand():
    scores = link_prediction.summarize(np.array([1.0, 2.0, 4.0, 20.0]))
    assert scores["mrr"] == pytest.approx((1 + 0.5 + 0.25 + 0.05) / 4)
    assert scores["hits_at_10"] == 0.75
    assert scores["mrr_heads"] == pytest.approx(0.15)


@pytest.mark.parametrize(
    ("name", "relation", "score"),
    [
        ("distmult", [1.0, 1.0, 2.0, 3.0], 2 + 0 + 6 - 12),
        ("transe", [1.0, 0.0, -1.0, 1.0], -(41**0.5)),
    ],
)
def test_scores_of_its_own_models_by_hand(own_models, name, relation, score):
    model = new_model(KgeConfig(model=name, dim=4), 2, 1)
    with torch.no_grad():
        model.entity.copy_(torch.tensor([[1.0, 2.0, 3.0, 4.0], [2.0, 0.0, 1.0, -1.0]]))
        model.relation[0].copy_(torch.tensor(relation))
    ids = torch.tensor([0]), torch.tensor([0])
    assert model(*ids)[0, 1].item() == pytest.approx(score)


def test_a_folder_is_ranked_by_every_model(own_models, tmp_path, monkeypatch):
    write_openke(split_graph(household()), tmp_path)
    file = tmp_path / "scores.json"
    options = [
        "--graph",
        str(tmp_path),
        "--seeds",
        "1",
        "--epochs",
        "20",
        "--json",
        str(file),
    ]
    monkeypatch.setattr(sys, "argv", ["link_prediction", *options, "--dim", "16"])
    link_prediction.main()
    rows = json.loads(file.read_text())["rows"]
    assert [row["model"] for row in rows] == [
        "analogy",
        "complex",
        "transe",
        "distmult",
    ]
    assert all(0.05 < row["mrr"] < 1 for row in rows)
