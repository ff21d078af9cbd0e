"""Runs of the algorithm "seen": no policy, and the same acts through every door."""

from pathlib import Path

import numpy as np
import pytest

import knowarm
from knowarm.asking.asker import ask
from knowarm.deploy.contract import deployment
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


def test_it_is_asked_and_stays_where_it_sees_no_answer(run):
    asked = ask(run.folder.path, "usedFor drinking")
    assert asked.right
    assert asked.film[-1].step > 3
    stays = ask(run.folder.path, "usedFor drinking", scene=asked.scene, unclear="stop")
    assert stays.stopped == (len(stays.candidates) != 1)


def test_it_cannot_leave_the_simulator_as_a_policy(run):
    with pytest.raises(UserError, match="no policy to take out"):
        deployment(knowarm.load_agent(run.folder.path))


def test_without_joint_angles_it_says_what_it_needs(run):
    trained = knowarm.load_agent(run.folder.path)
    trained.reset({"query": np.array(["usedFor drinking"])})
    with pytest.raises(UserError, match="joint angles as episodes start"):
        trained.act(np.zeros((64, 64, 3), np.uint8))


def test_an_agent_without_a_network_is_refused_before_anything_is_trained():
    with pytest.raises(UserError, match=r"has none. Take one of .*answers"):
        knowarm.experiment_config("irb120-full-seen")


def test_an_edited_fact_puts_the_mug_on_another_tray():
    run = ZOO / "tiago-choose-sort-answers-seen"
    asked = ask(run, "put the red mug where it belongs", scene=1)
    assert asked.told == ("the cyan tray is the garage; the yellow tray is the kitchen")
    assert asked.result == "It stands on the yellow tray, the kitchen."
    assert asked.right
    assert asked.within
    edit = ["- mug isLocatedIn kitchen", "+ mug isLocatedIn garage"]
    edited = ask(run, "put the red mug where it belongs", scene=1, edit=edit)
    assert edited.told == asked.told
    assert edited.result == "It stands on the cyan tray, the garage."
