"""Calibration: the right object is among the candidates as often as the level says."""

from pathlib import Path

import numpy as np
import pytest
import torch

from knowarm.errors import UserError
from knowarm.experiment.load import load_agent
from knowarm.perception import calibration
from knowarm.perception.calibration import (
    calibrated_thresholds,
    nearest_place,
    quantile,
    thresholds_of,
)
from knowarm.perception.images import query_answers, sample_images
from knowarm.perception.recognition import AnswerGrounding
from knowarm.questions import number_objects

ZOO = Path(__file__).parents[2] / "zoo" / "irb120-choose-answers-fast"


@pytest.mark.parametrize("level", [0.5, 0.8, 0.95])
def test_a_further_score_reaches_the_quantile_as_often_as_the_level(level):
    random = np.random.default_rng(0)
    reached = [
        random.standard_normal() >= quantile(random.standard_normal(39), level)
        for _ in range(4_000)
    ]
    assert np.mean(reached) == pytest.approx(level, abs=0.02)
    assert quantile(np.arange(5.0), 0.99) == 0  # too few scores for such a level


def test_each_object_has_its_own_quantile_unless_its_scores_are_few():
    objects = np.array([0, 0, 1, 2, 3])  # the first object has two colours
    facets = np.repeat([0, 1, 2, 3], [30, 30, 60, 20])
    likelihoods = np.linspace(0, 1, 140)
    found = thresholds_of(likelihoods, facets, objects, 0.9)
    every = quantile(likelihoods, 0.9)
    first = quantile(likelihoods[:60], 0.9)
    second = quantile(likelihoods[60:120], 0.9)
    assert found == pytest.approx([first, first, second, every, every])
    assert first < every < second
    with_more = thresholds_of(likelihoods, facets, objects, 0.8)
    assert with_more[3] == pytest.approx(quantile(likelihoods[120:], 0.8))


@torch.no_grad()
@pytest.mark.parametrize("level", [0.7, 0.95])
def test_the_right_object_is_among_the_candidates(trained, level):
    """Of queries on further images: at least the level, as they have more than one answer."""
    env, network = trained.config.env, trained.network
    thresholds = calibrated_thresholds(network, env, level, trained.config.seed)
    labels = sample_images(env, network.spec, 400, seed=77)
    answers = query_answers(env, network.spec.facets).satisfies
    seen = AnswerGrounding(network, answers).see(labels.images, answers[labels.queries])
    nearest = nearest_place(seen.places, labels.pixels[:, 0], network.spec.image_size)
    found = seen.candidates(thresholds).gather(1, nearest[:, None]).float().mean()
    assert found > level - 0.04
    few = seen.candidates(thresholds).sum(1).float().mean()
    many = seen.candidates(torch.zeros_like(thresholds)).sum(1).float().mean()
    assert few < 2 < many == 4


@torch.no_grad()
def test_the_level_holds_for_each_object():
    """Asked by name and colour, on images of a seed far from that of the calibration."""
    trained = load_agent(ZOO)
    env = trained.config.env
    network = trained.network
    facets = network.spec.facets
    labels = sample_images(env, network.spec, 1_200, seed=7_000_000)
    grounding = AnswerGrounding(network, torch.ones(1, len(facets)))
    objects = torch.from_numpy(number_objects(facets))
    arrays = calibration.name_likelihoods(network, env, trained.config.seed)
    alike = np.zeros(len(facets), np.int64)  # one quantile for all
    everything = torch.ones(1, len(facets)).expand(100, -1)
    parts = []
    for start in range(0, len(labels.images), 100):
        rows = slice(start, start + 100)
        parts.append((rows, grounding.see(labels.images[rows], everything)))
    least = {}
    sizes = {}
    for name, groups in {"own": objects.numpy(), "one": alike}.items():
        thresholds = torch.from_numpy(
            thresholds_of(arrays["likelihoods"], arrays["facets"], groups, 0.9)
        )
        covered = torch.zeros(labels.facets.shape)
        counts = torch.zeros(labels.facets.shape)
        for rows, seen in parts:
            for column in range(labels.facets.shape[1]):
                asked = torch.nn.functional.one_hot(
                    labels.facets[rows, column], len(facets)
                )
                alone = seen._replace(likelihoods=seen.likelihoods * asked[:, :, None])
                candidates = alone.candidates(thresholds)
                pixels = labels.pixels[rows, column]
                nearest = nearest_place(seen.places, pixels, network.spec.image_size)
                covered[rows, column] = (
                    candidates.gather(1, nearest[:, None])[:, 0] * 1.0
                )
                counts[rows, column] = candidates.sum(1).float()
        shares = []
        for number in objects.unique():
            is_it = objects[labels.facets] == number
            if is_it.sum() > 100:
                shares.append(covered[is_it].mean().item())
        assert len(shares) == 20
        assert covered.mean().item() == pytest.approx(0.9, abs=0.02)
        least[name] = min(shares)
        sizes[name] = counts.mean().item()
    assert least["own"] > 0.82
    assert least["own"] > least["one"] + 0.04
    assert sizes["own"] < sizes["one"] + 0.03


def test_a_level_is_a_share(trained):
    with pytest.raises(UserError, match=r"level is 1\.5; it must be above 0"):
        calibrated_thresholds(trained.network, trained.config.env, 1.5, 0)
