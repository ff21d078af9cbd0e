"""Calibration: the right object is among the candidates as often as the level says."""

import numpy as np
import pytest
import torch

from knowarm.errors import UserError
from knowarm.perception.answering import AnswerGrounding
from knowarm.perception.calibration import calibrated_threshold, nearest_place, quantile
from knowarm.perception.images import query_answers, sample_images


@pytest.mark.parametrize("level", [0.5, 0.8, 0.95])
def test_a_further_score_reaches_the_quantile_as_often_as_the_level(level):
    random = np.random.default_rng(0)
    reached = [
        random.standard_normal() >= quantile(random.standard_normal(39), level)
        for _ in range(4_000)
    ]
    assert np.mean(reached) == pytest.approx(level, abs=0.02)
    assert quantile(np.arange(5.0), 0.99) == 0  # too few scores for such a level


@torch.no_grad()
@pytest.mark.parametrize("level", [0.7, 0.95])
def test_the_right_object_is_among_the_candidates(trained, level, monkeypatch):
    """Of queries on further images: at least the level, as they have more than one answer."""
    env, network = trained.config.env, trained.network
    threshold = calibrated_threshold(network, env, level, trained.config.seed)
    labels = sample_images(env, network.spec, 400, seed=77)
    answers = query_answers(env, network.spec.facets).satisfies
    seen = AnswerGrounding(network, answers).see(labels.images, answers[labels.queries])
    nearest = nearest_place(seen.places, labels.pixels[:, 0], network.spec.image_size)
    found = seen.candidates(threshold).gather(1, nearest[:, None]).float().mean()
    assert found > level - 0.04
    few = seen.candidates(threshold).sum(1).float().mean()
    many = seen.candidates(0.0).sum(1).float().mean()
    assert few < 2 < many == 4


def test_a_level_is_a_share(trained):
    with pytest.raises(UserError, match=r"level is 1\.5; it must be above 0"):
        calibrated_threshold(trained.network, trained.config.env, 1.5, 0)
