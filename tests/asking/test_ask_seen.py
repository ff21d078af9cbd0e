"""Runs that see and solve are asked as any other: they act, or stay."""

from dataclasses import replace
from pathlib import Path

import pytest

import knowarm
from knowarm.asking.asker import ask

pytestmark = pytest.mark.usefixtures("small_films")

ZOO = Path(__file__).parents[2] / "zoo"

TAUGHT = ZOO / "irb120-choose-answers-fast"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    runs = tmp_path_factory.mktemp("runs")
    network = TAUGHT / "perception.safetensors"
    return knowarm.train("irb120-choose-answers-seen", runs, perception=network)


def test_it_is_asked_and_stays_where_it_sees_no_answer(run):
    asked = ask(run.folder.path, "usedFor drinking")
    assert asked.right
    assert asked.film[-1].step > 3
    stays = ask(run.folder.path, "usedFor drinking", scene=asked.scene, unclear="stop")
    assert stays.stopped == (len(stays.candidates) != 1)


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
    # Whether it belongs there is judged by the edited graph.
    assert edited.within
    # A fact that is missing is no reason to take any tray.
    missing = ask(run, "put the red mug where it belongs", scene=1, edit=edit[:1])
    assert missing.lacks_place
    assert (
        "The arm stayed: the graph does not say at which one of these places"
        in missing.outcome
    )
    way = missing.film[-1].joints - missing.film[0].joints
    assert abs(way).max() < 0.02


def test_a_scene_of_a_single_object_can_be_asked_about():
    trained = knowarm.load_agent(ZOO / "tiago-choose-sort-answers-seen")
    config = trained.config
    task = replace(config.env.task, asked=replace(config.env.task.asked, objects=1))
    trained.config = replace(config, env=replace(config.env, task=task))
    trained.network.spec = replace(trained.network.spec, objects=1)
    asked = ask(trained, "put the mug where it belongs")
    assert len(asked.shown) == 1
    assert asked.right
    assert asked.within
