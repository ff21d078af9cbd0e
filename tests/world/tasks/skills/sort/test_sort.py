"""Sorting: which tray is right, what is told and seen of trays, and the oracle that sorts."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import knowarm
from knowarm.errors import UserError
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.graph.builder import graph_of
from knowarm.knowledge.graph.edits import edited
from knowarm.world.robots import ROBOTS, find_robot
from knowarm.world.tasks.asked.query.query import AskObject
from knowarm.world.tasks.asked.query.query_source import GraphQueries
from knowarm.world.tasks.skills.guides import Sight
from knowarm.world.tasks.skills.place.tray import centres_m
from knowarm.world.tasks.skills.sort.looking import trays_by_colour
from knowarm.world.tasks.skills.sort.sort import TRAY_COLOURS, Sort
from knowarm.world.tasks.task import Task
from tests.thorough import thorough

WHERE = {
    "mug": {"kitchen"},
    "bottle": {"kitchen"},
    "kettle": {"kitchen"},
    "pitcher": {"kitchen"},
    "wine_glass": {"living_room"},
    "vase": {"living_room"},
    "pan": {"kitchen"},
    "candle": {"living_room"},
    "mallet": {"garage"},
    "brush": {"garage"},
    "basket": {"garden"},
    "watering_can": {"garden"},
    "clock": {"living_room", "classroom"},
    "toolbox": {"garage"},
    "bell": {"classroom"},
    "globe": {"living_room", "classroom"},
}
"""What the shipped graph states of the objects that both grippers hold."""


def make_env(robot="irb120", count=32, task="choose-sort", **options):
    return knowarm.make(robot, num_envs=count, task=task, **options)


@cache
def env_of(robot, task="choose-sort"):
    return make_env(robot, 64, task, image_size=64)


def started(env, seed=0):
    episodes = knowarm.evaluation_episodes(env.config, env.num_envs, seed)
    images, _ = env.reset(options={"episodes": episodes})
    return images.copy(), episodes


def facts_of(env):
    return env.config.task.skill.facts(env.running, env.config.task.asked)


def seen(env, images, graph):
    skill = env.config.task.skill
    sight = Sight.true(env.running)._replace(destination=None)
    return skill.see(env.scene, sight, images, facts_of(env), graph).destination


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_object_belongs_at_exactly_one_of_the_places_and_the_tray_is_there(robot):
    env = env_of(robot)
    _, episodes = started(env)
    facts = facts_of(env)
    centres = centres_m(env.scene.robot)
    memory = env.running.memory
    trays = np.argmax((centres == memory["destination"][:, None]).all(axis=2), axis=1)
    for number, name in enumerate(episodes.names[:, 0]):
        places = facts["tray_places"][number].tolist()
        colours = facts["tray_colours"][number].tolist()
        assert len(set(places)) == len(set(colours)) == len(centres)
        (right,) = WHERE[name] & set(places)
        colour = colours[places.index(right)]
        number_of_colour = memory["tray_colours"][number][trays[number]]
        assert TRAY_COLOURS[number_of_colour] == colour
    counts = np.bincount(trays, minlength=len(centres))
    assert counts.min() > 64 / len(centres) / 3


def test_what_is_told_of_trays_says_nothing_of_where_they_stand():
    env = env_of("irb120")
    started(env)
    order = facts_of(env)["tray_places"]
    assert (np.sort(order, axis=1) == order).all()
    told = env.running.instruct(0)
    question, *trays = told.split("; ")
    assert " " in question
    assert all(words.startswith("the ") and " tray is the " in words for words in trays)
    assert len(trays) == 3
    _, infos = env.reset(seed=1)
    assert infos["tray_places"].shape == infos["tray_colours"].shape == (64, 3)


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_colours_of_trays_are_read_from_pixels(robot):
    env = env_of(robot)
    images, _ = started(env)
    colours = facts_of(env)["tray_colours"]
    centres = centres_m(env.scene.robot)
    memory = env.running.memory["tray_colours"][:, : len(centres)]
    true = np.array(TRAY_COLOURS)[memory]
    trays = trays_by_colour(env.scene, images, centres, colours)
    right = np.take_along_axis(true, trays, axis=1) == colours
    assert right.all(axis=1).mean() >= 0.98
    turned = trays_by_colour(env.scene, images[::-1].copy(), centres, colours)
    assert (np.take_along_axis(true, turned, axis=1) == colours).mean() < 0.7


def test_the_graph_that_is_known_decides_for_a_tray():
    env = env_of("irb120")
    images, _ = started(env)
    right = env.running.memory["destination"]
    graph = read_graph("objects")
    assert (seen(env, images, graph) == right).all(axis=1).mean() >= 0.98
    unknown = (seen(env, images, None) == right).all(axis=1)
    assert 0.15 < unknown.mean() < 0.55
    nothing_stated = graph_of([("mug", "isA", "thing")])
    first = seen(env, images, nothing_stated)
    np.testing.assert_array_equal(first, seen(env, images, None))


def test_a_graph_that_names_two_of_the_places_decides_for_neither():
    env = env_of("irb120")
    images, episodes = started(env)
    facts = facts_of(env)
    sight = Sight.true(env.running)._replace(destination=None)
    skill = env.config.task.skill
    graph = read_graph("objects")
    assert skill.see(env.scene, sight, images, facts, graph).decided.all()
    name = episodes.names[0, 0]
    others = [place for place in facts["tray_places"][0] if place not in WHERE[name]]
    both = edited(graph, [f"+ {name} isLocatedIn {others[0]}"])
    assert not skill.see(env.scene, sight, images, facts, both).decided[0]


@cache
def named_env(destination):
    """Scenes of which the question names the destination."""
    task = Task(asked=AskObject(), skill=Sort(destination=destination))
    return make_env(count=64, task=task, image_size=64)


def test_a_named_destination_is_the_place_of_any_tray_in_the_same_scenes():
    env = named_env("place")
    _, episodes = started(env)
    told = facts_of(env)
    destination = told["destination"]
    at = told["tray_places"] == destination[:, None]
    assert (at.sum(axis=1) == 1).all()
    belongs = []
    for place, name in zip(destination, episodes.names[:, 0], strict=True):
        belongs.append(place in WHERE[name])
    assert 0.15 < np.mean(belongs) < 0.55
    right = env.running.memory["destination"]
    colours = env.running.memory["tray_colours"][:, :3]
    tray = (centres_m(env.scene.robot) == right[:, None]).all(axis=2).argmax(axis=1)
    colour = np.array(TRAY_COLOURS)[colours[np.arange(64), tray]]
    np.testing.assert_array_equal(told["tray_colours"][at], colour)
    words = env.running.instruct(0).split("; ")
    assert words[1] == f"the destination is the {destination[0].replace('_', ' ')}"
    # The question apart, the scene is that of the task without it.
    unnamed = env_of("irb120")
    _, others = started(unnamed)
    np.testing.assert_array_equal(others.positions, episodes.positions)
    before = facts_of(unnamed)
    assert set(told) - set(before) == {"destination"}
    for name, values in before.items():
        np.testing.assert_array_equal(values, told[name])


def test_a_destination_may_be_named_by_the_colour_of_its_tray():
    env = named_env("place")
    started(env)
    told = facts_of(env)
    at = told["tray_places"] == told["destination"][:, None]
    by_colour = named_env("colour")
    started(by_colour)
    colours = facts_of(by_colour)["destination"]
    np.testing.assert_array_equal(colours, told["tray_colours"][at])
    words = by_colour.running.instruct(0).split("; ")
    assert words[1] == f"the destination is the {colours[0]} tray"


@pytest.mark.parametrize("destination", ["place", "colour"])
def test_a_destination_that_is_told_counts_more_than_the_graph(destination):
    env = named_env(destination)
    images, _ = started(env)
    right = env.running.memory["destination"]
    for graph in (read_graph("objects"), None):
        assert (seen(env, images, graph) == right).all(axis=1).mean() >= 0.98
    skill = env.config.task.skill
    told = facts_of(env)
    del told["destination"]
    sight = Sight.true(env.running)._replace(destination=None)
    graph = read_graph("objects")
    by_graph = skill.see(env.scene, sight, images, told, graph).destination
    assert 0.15 < (by_graph == right).all(axis=1).mean() < 0.55
    assert skill.without_destination() == Sort()


def test_an_edited_graph_changes_where_things_belong():
    asked = AskObject(queries=GraphQueries(split="S5"))
    env = make_env(count=64, task=Task(asked=asked, skill=Sort()), image_size=64)
    images, episodes = started(env)
    facts = facts_of(env)
    graph = asked.answering_graph(env.running.facets)
    right = env.running.memory["destination"]
    assert (seen(env, images, graph) == right).all(axis=1).mean() >= 0.98
    before = (seen(env, images, read_graph("objects")) == right).all(axis=1)
    moved = []
    for number, name in enumerate(episodes.names[:, 0]):
        moved.append(not WHERE[name] & set(facts["tray_places"][number]))
    assert np.mean(moved) > 0.1
    assert before[~np.array(moved)].mean() > before[moved].mean()


COUNT = thorough(8, 12)
"""Episodes of the oracle."""


@cache
def played():
    env = make_env(count=COUNT, image_size=8)
    episodes = knowarm.evaluation_episodes(env.config, COUNT, seed=0)
    return knowarm.play(knowarm.OracleAgent(env), env, episodes)


def test_the_oracle_sorts():
    result = played()
    assert result.success.mean() >= 0.75
    assert (result.infos["placing"][result.success] == "placed").all()


def test_on_another_tray_it_is_lost_as_such():
    env = make_env(count=COUNT, image_size=8)
    episodes = knowarm.evaluation_episodes(env.config, COUNT, seed=0)
    env.reset(options={"episodes": episodes})
    agent = knowarm.OracleAgent(env)
    centres = centres_m(env.scene.robot)
    right = env.running.memory["destination"]
    number = np.argmax((centres == right[:, None]).all(axis=2), axis=1)
    wrong = Sight.true(env.running)._replace(destination=centres[(number + 1) % 3])
    agent.path = agent.guide.path(wrong)
    placing = np.full(COUNT, "running  ", "<U16")
    for _ in range(159):
        _, _, ended, _, infos = env.advance(agent.act({}), np.zeros(COUNT, bool))
        is_new = ended & (placing == "running  ")
        placing[is_new] = infos["placing"][is_new]
    assert (placing == "wrong_tray").mean() >= 0.6
    assert not (placing == "placed").any()


def test_a_restored_state_has_its_trays_and_continues_to_the_byte():
    env = make_env(count=4, image_size=16)
    started(env)
    actions = np.ones((4, 7), np.int64)
    env.advance(actions, np.zeros(4, bool))
    state = env.get_state()
    first = [env.advance(actions, np.zeros(4, bool))[:2] for _ in range(3)]
    env.reset(seed=9)
    env.set_state(state)
    again = [env.advance(actions, np.zeros(4, bool))[:2] for _ in range(3)]
    for (images, rewards), (same, equal) in zip(first, again, strict=True):
        np.testing.assert_array_equal(images, same)
        np.testing.assert_array_equal(rewards, equal)


@pytest.mark.parametrize(
    ("skill", "changes", "message"),
    [
        (
            Sort(relation="isMadeOf"),
            {"targets": ("mug", "bell", "pan")},
            "3 trays need",
        ),
        (
            Sort(),
            {"targets": ("mug", "kettle", "bottle", "pan")},
            r"states 1 for them. Set task.skill.relation to",
        ),
        (Sort(), {"targets": ("clock", "mug", "bell", "vase")}, "3 trays need"),
    ],
)
def test_what_cannot_be_sorted_is_refused_with_a_remedy(skill, changes, message):
    asked = AskObject(objects=2, queries=GraphQueries(hold_out=()))
    with pytest.raises(UserError, match=message):
        make_env(count=8, task=Task(asked=asked, skill=skill), **changes).reset(seed=0)


def test_a_robot_with_one_tray_is_refused_with_a_remedy():
    robot = replace(find_robot("irb120"), trays_m=((0.2, -0.25),))
    with pytest.raises(UserError, match=r"has 1 trays.*needs 2.*Set trays_m"):
        Sort().area_of(robot)
