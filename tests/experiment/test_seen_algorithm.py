"""Runs of the algorithm "seen": no policy, and the same acts through every door."""

from pathlib import Path

import numpy as np
import pytest

import knowarm
from knowarm.errors import UserError
from knowarm.experiment.evaluation import SeenTest
from knowarm.perception.solving import SolvingAgent

ZOO = Path(__file__).parents[2] / "zoo"

TAUGHT = ZOO / "irb120-choose-answers-fast"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    runs = tmp_path_factory.mktemp("runs")
    network = TAUGHT / "perception.safetensors"
    return knowarm.train("irb120-choose-answers-seen", runs, perception=network)


def test_its_evaluation_is_that_of_a_policy_whose_network_is_seen_and_solved(run):
    options = {"episodes": 24, "probes": (), "write": False}
    acts = knowarm.evaluate(run, **options)
    seen = knowarm.evaluate(TAUGHT, test=(SeenTest(),), **options)
    policy = knowarm.evaluate(TAUGHT, **options)
    assert set(acts.episodes) == set(seen.episodes)
    for name, values in acts.episodes.items():
        np.testing.assert_array_equal(values, seen.episodes[name])
    assert (acts.episodes["length"] != policy.episodes["length"]).any()
    assert acts.summary["success"] > 0.7


def test_what_plays_is_the_same_through_the_loaded_agent(run):
    trained = knowarm.load_agent(run.folder.path)
    assert isinstance(trained.player, SolvingAgent)
    options = {"episodes": 24, "probes": (), "write": False}
    played = knowarm.evaluate(trained.player, trained.config.env, **options)
    stored = knowarm.evaluate(run, **options)
    for name in ("length", "distance_m", "chosen"):
        np.testing.assert_array_equal(played.episodes[name], stored.episodes[name])


def test_it_resumes_and_has_a_best_checkpoint(run):
    again = knowarm.train(
        "irb120-choose-answers-seen", run.folder.path.parents[1], resume=True
    )
    assert again.result.reason == "finished"
    assert knowarm.load_agent(run.folder.path, which="latest").step == 1


def test_without_joint_angles_it_says_what_it_needs(run):
    trained = knowarm.load_agent(run.folder.path)
    trained.reset({"query": np.array(["usedFor drinking"])})
    with pytest.raises(UserError, match="joint angles as episodes start"):
        trained.act(np.zeros((64, 64, 3), np.uint8))


def test_an_agent_without_a_network_is_refused_before_anything_is_trained():
    with pytest.raises(UserError, match=r"has none. Take one of .*answers"):
        knowarm.experiment_config("irb120-full-seen")
