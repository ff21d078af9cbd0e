"""Policies that are told where to put an object, by what a network sees and a graph states."""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

import knowarm
from knowarm.errors import UserError
from knowarm.experiment.evaluation import PlacesTest
from knowarm.experiment.load import load_agent
from knowarm.experiment.run import build
from knowarm.perception.solving import PlacingAgent
from knowarm.world.agents import Batch
from knowarm.world.envs.vector_env import ArmVectorEnv

ZOO = Path(__file__).parents[2] / "zoo"
SEEN = ZOO / "tiago-choose-sort-answers-seen"
NAME = "tiago-choose-sort-answers-distil"


@pytest.fixture(scope="module")
def knowledge():
    network = load_agent(SEEN).network
    config = knowarm.experiment_config(NAME)
    return config.knows.known(config.env, 0, network=network)


def places_of(knowledge, told):
    """Return x and y of what policies are told (n, K), (n, 2) [m]."""
    network = knowledge.recognition.network
    return (told[:, -2:] * network.position_std[:2] + network.position_mean[:2]).numpy()


def test_in_training_a_policy_is_told_the_right_tray(knowledge):
    config = knowarm.experiment_config(NAME)
    with closing(knowledge.make_env(config.env, 6)) as env:
        env.teach()
        env.reset(seed=0)
        places = env.running.memory["destination"]
        assert len(np.unique(places, axis=0)) == 2
        assert env.knowledge.shape == (6, build(config).policy_shape.knowledge_dim)
        np.testing.assert_allclose(
            places_of(knowledge, env.knowledge), places, atol=1e-6
        )


def test_without_a_teacher_nothing_tells_it(knowledge):
    config = knowarm.experiment_config(NAME)
    with (
        closing(knowledge.make_env(config.env, 1)) as env,
        pytest.raises(UserError, match="Train with 'distil'"),
    ):
        env.reset(seed=0)


@pytest.mark.parametrize(
    ("change", "least", "most"),
    [({}, 0.8, 1), ({"_graph": None}, 0, 0.7), ({"_swaps": True}, 0, 0.2)],
)
def test_in_play_it_is_told_the_tray_that_is_seen(knowledge, change, least, most):
    config = knowarm.experiment_config(NAME)
    policy = build(config).new_policy(0)
    agent = knowledge.make_player(config.env, policy, greedy=True)
    assert isinstance(agent, PlacingAgent)
    vars(agent).update(change)
    with closing(ArmVectorEnv(config.env, 24)) as env:
        images, _ = env.reset(seed=3)
        # It needs no joint angles.
        batch = Batch.of(env)
        agent.reset(Batch(env=batch.env, names=batch.names, facts=batch.facts))
        agent.act({"image": images})
        told = places_of(knowledge, agent.agent.knowledge)
        places = env.running.memory["destination"]
        trays = config.env.task.skill.tray_centres(env.scene.robot)
    is_right = np.isclose(told, places, atol=1e-6).all(axis=1)
    assert least <= is_right.mean() <= most
    is_a_tray = np.isclose(told[:, None], trays, atol=1e-6).all(axis=2).any(axis=1)
    assert is_a_tray.all()


def test_without_the_facts_of_an_episode_it_says_what_it_needs(knowledge):
    config = knowarm.experiment_config(NAME)
    policy = build(config).new_policy(0)
    agent = knowledge.make_player(config.env, policy, greedy=True)
    with closing(ArmVectorEnv(config.env, 1)) as env:
        env.reset(seed=3)
        batch = Batch.of(env)
    with pytest.raises(UserError, match="facts of the episode, which are not given"):
        agent.reset(Batch(env=batch.env, names=batch.names))


def test_what_it_knows_of_places_has_controls():
    # Of these episodes the second tray is right, and the first one is a guess.
    options = {"episodes": 2, "seed": 2, "probes": (), "write": False}
    control = PlacesTest(places="unknown")
    unknown = knowarm.evaluate(SEEN, test=(control,), **options)
    assert unknown.summary.label == "post-training-greedy-places-unknown"
    swapped = knowarm.evaluate(SEEN, test=(PlacesTest(places="swapped"),), **options)
    known = knowarm.evaluate(SEEN, **options)
    for other in (unknown, swapped):
        np.testing.assert_array_equal(other.episodes["placing"], "wrong_tray")
    np.testing.assert_array_equal(known.episodes["placing"], "placed")
    with pytest.raises(UserError, match="a graph says where objects belong"):
        knowarm.evaluate(ZOO / "tiago-choose-answers-fast", test=(control,), **options)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("tiago-choose-sort-answers-fast", "Only a teacher tells"),
        ("tiago-choose-sort-subgraph-film-distil", "is not told where to put"),
        ("tiago-sort-full-distil", "is not told where to put"),
    ],
)
def test_who_is_not_told_cannot_be_trained(name, message):
    with pytest.raises(UserError, match=message):
        build(knowarm.experiment_config(name))
