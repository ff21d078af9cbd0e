"""An agent that is loaded with another graph, and what it says of what is new to it."""

import logging
from dataclasses import replace
from itertools import chain

import numpy as np
import pytest

import knowarm
from knowarm.errors import UserError
from knowarm.experiment.evaluation import GraphTest, SplitTest
from knowarm.knowledge.formats import write_graph
from tests.source_tree import ROOT

ZOO = ROOT / "zoo"
ANSWERS = ZOO / "irb120-choose-answers-fast"
SUBGRAPH = ZOO / "irb120-choose-subgraph-fast"
JUDGED = {"success_distance_m": 0.1, "success_angle_deg": 17.0}  # of evaluations


def same(result, evaluated):
    """Check that episodes were played as an evaluation plays them, to the last bit."""
    columns = evaluated.episodes
    np.testing.assert_array_equal(columns["return"], result.episode_return)
    np.testing.assert_array_equal(columns["length"], result.length)
    np.testing.assert_array_equal(columns["distance_m"], result.distance)


@pytest.mark.parametrize("path", [ANSWERS, SUBGRAPH])
def test_an_environment_of_an_edited_graph_is_played_as_evaluate_does(path, tmp_path):
    trained = knowarm.load_agent(path)
    task = trained.config.env.task.asking(split="S5")
    env = knowarm.ArmVectorEnv(replace(trained.config.env, task=task, **JUDGED), 30)
    edited = env.config.task.asked.edited_graph(env.facets)
    write_graph(edited, tmp_path / "edited graph.ttl")
    test = (SplitTest(split="S5"),)
    evaluated = knowarm.evaluate(
        trained, episodes=30, test=test, probes=(), write=False
    )
    episodes = knowarm.evaluation_episodes(
        env.config, 30, seed=evaluated.summary.config.seed
    )
    for graph in (edited, tmp_path / "edited graph.ttl"):
        other = knowarm.load_agent(path, graph=graph)
        same(knowarm.play(other, env, episodes), evaluated)
    by_own = knowarm.play(trained, env, episodes)
    right = evaluated.summary["choice"]
    assert by_own.infos["is_right_object"].mean() < right
    if path == ANSWERS:
        assert right > 0.85


def test_an_agent_with_another_graph_is_evaluated_with_it_and_keeps_its_run(tmp_path):
    lines = ["mug,usedFor,signalling", "teapot,usedFor,signalling"]
    names = ["bottle", "kettle", "pot", "vase", "bowl", "jar"]
    lines += [f"{name},usedFor,storing" for name in names]
    for name in ("mug", "teapot", *names):
        lines += [f"{name},hasShape,{name[0]}", f"{name},isA,thing"]
    path = tmp_path / "mine.csv"
    path.write_text("\n".join(lines))
    options = {"episodes": 20, "probes": (), "write": False}
    by_test = knowarm.evaluate(ANSWERS, test=(GraphTest(graph=str(path)),), **options)
    agent = knowarm.load_agent(ANSWERS, graph=path)
    evaluated = knowarm.evaluate(agent, **options)
    np.testing.assert_array_equal(
        evaluated.episodes["return"], by_test.episodes["return"]
    )
    assert set(evaluated.episodes["target"]) <= {line.split(",")[0] for line in lines}
    env = knowarm.ArmVectorEnv(replace(agent.config.env, **JUDGED), 20)
    seed = evaluated.summary.config.seed
    episodes = knowarm.evaluation_episodes(env.config, 20, seed=seed)
    same(knowarm.play(agent, env, episodes), evaluated)
    with pytest.raises(UserError, match="not the agent's own"):
        knowarm.evaluate(agent, episodes=2)


@pytest.mark.parametrize(
    ("path", "graph", "message"),
    [
        (ZOO / "irb120-full-fast", "objects", "has no queries that a graph could ans"),
        (ANSWERS, "nowhere.ttl", "nowhere.ttl"),
        (ANSWERS, "mug usedFor drinking", "mug usedFor drinking"),
        (ANSWERS, "small.csv", "describes 1 objects of the task"),
    ],
)
def test_a_graph_that_does_not_fit_is_refused_in_one_line(
    path, graph, message, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.csv").write_text("mug,usedFor,drinking\nrock,usedFor,throwing\n")
    with pytest.raises(UserError, match=message) as error:
        knowarm.load_agent(path, graph=graph)
    assert "\n" not in str(error.value)


EIGHT = ("clock", "pan", "toolbox", "mug", "bottle", "kettle", "teapot", "pot")


def new_things(caplog):
    """Return what is said to be new to an agent: objects, and questions."""
    lines = [
        text for text in caplog.messages if "meets what its training never" in text
    ]
    told = {"showed": [], "asked": []}
    for line in lines:
        kind, names = line.partition("never ")[2].partition(". ")[0].split(": ")
        told[kind].append(names.split("; "))
    return told


@pytest.mark.parametrize("count", [None, 16])
def test_what_is_new_to_an_agent_is_said_once(count, caplog):
    agent = knowarm.load_agent(ANSWERS)
    task = agent.config.env.task
    caplog.set_level(logging.WARNING)
    other = list(reversed(agent.config.env.targets))
    for targets in ((), other):
        env = knowarm.make("irb120", count, task=task, targets=targets)
        agent.reset(env.reset(seed=0)[1])
    assert not caplog.messages
    env = knowarm.make("irb120", count, task=task, targets=EIGHT)
    for seed in range(40):
        agent.reset(env.reset(seed=seed)[1])
    told = new_things(caplog)
    assert sorted(chain.from_iterable(told["showed"])) == ["clock", "pan", "toolbox"]
    assert len(told["asked"]) == 1
    assert "mug" not in caplog.text
    caplog.clear()
    agent.reset(knowarm.ArmVectorEnv(agent.training, 2).reset(seed=0)[1])
    assert not caplog.messages


def test_what_is_new_is_said_of_lists_of_episodes_and_of_single_objects(caplog):
    agent = knowarm.load_agent(ZOO / "irb120-full-fast")
    env = knowarm.make("irb120", 4, targets=("mug", "kettle"), colours="randomized")
    knowarm.play(agent, env, knowarm.evaluation_episodes(env.config, 4, seed=0))
    assert new_things(caplog) == {"showed": [["blue mug", "kettle"]], "asked": []}
    _, info = knowarm.make("irb120", targets=("globe",)).reset(seed=0)
    agent.reset(info)
    agent.reset(info)
    assert new_things(caplog)["showed"][1:] == [["globe"]]
    caplog.clear()
    asking = knowarm.load_agent(ANSWERS)
    asking.reset({"query": "usedFor drinking"})
    assert not caplog.messages
    held_out = "usedFor carrying"
    asking.reset({"query": held_out})
    assert new_things(caplog)["asked"] == [[held_out]]
