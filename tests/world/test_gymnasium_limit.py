"""The limit of steps by Gymnasium's own argument, in every way to make an environment."""

import copy
import json
import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

import knowarm
from knowarm.errors import UserError
from knowarm.world.agents.play import play
from knowarm.world.agents.scripted import OracleAgent, ZeroAgent
from knowarm.world.envs.episodes import evaluation_episodes
from tests.mujoco_version import LIFTS

ID = "knowarm/IRB120Reach-v0"
SMALL: dict[str, Any] = {"image_size": 8, "dynamics": "kinematic"}
STILL = np.full(6, 3)


def steps_of(env: Any, most: int = 200) -> int:
    """Return after how many steps without a movement the first episode is truncated."""
    env.reset(seed=0)
    still = np.broadcast_to(STILL, env.action_space.shape)
    for step in range(1, most + 1):
        _, _, terminated, truncated, _ = env.step(still)
        assert not np.any(terminated)
        if np.any(truncated):
            return step
    return -1


@pytest.mark.parametrize(
    ("option", "steps"),
    [
        ({}, 50),
        ({"max_episode_steps": None}, 50),
        ({"max_episode_steps": 7}, 7),
        ({"max_episode_steps": 50}, 50),
        ({"max_episode_steps": 120}, 120),
    ],
)
def test_every_way_to_make_one_truncates_at_the_limit(
    option: dict[str, Any], steps: int
) -> None:
    single = gymnasium.make(ID, **SMALL, **option)
    assert single.spec is not None
    assert single.spec.max_episode_steps == steps
    spec = EnvSpec.from_json(single.spec.to_json())
    makers = {
        "make": lambda: single,
        "spec": lambda: gymnasium.make(spec),
        "copy": lambda: copy.deepcopy(gymnasium.make(ID, **SMALL, **option)),
        "pickle": lambda: pickle.loads(pickle.dumps(single)),
        "vector": lambda: gymnasium.make_vec(ID, 2, **SMALL, **option),
        "sync": lambda: gymnasium.make_vec(ID, 2, "sync", **SMALL, **option),
        "own": lambda: knowarm.make(ID, **SMALL, max_episode_steps=steps),
    }
    assert {name: steps_of(make()) for name, make in makers.items()} == dict.fromkeys(
        makers, steps
    )


def test_a_spec_of_one_s_own_states_the_limit() -> None:
    spec = copy.deepcopy(gymnasium.spec(ID))
    assert spec.max_episode_steps == 50
    assert json.loads(spec.to_json())["max_episode_steps"] == 50
    spec.max_episode_steps = 9
    assert steps_of(gymnasium.make(spec, **SMALL)) == 9
    assert steps_of(gymnasium.make_vec(spec, 2, **SMALL)) == 9


def test_without_a_limit_an_episode_goes_on() -> None:
    endless = gymnasium.make(ID, max_episode_steps=-1, **SMALL)
    assert steps_of(endless) == -1
    assert steps_of(gymnasium.make(ID, **SMALL).unwrapped) == -1
    for wrong, error in ((0, ValueError), (-2, ValueError), (7.5, TypeError)):
        with pytest.raises(error, match="max_episode_steps"):
            gymnasium.make(ID, max_episode_steps=wrong, **SMALL)
    for wrong in (-1, 7.5, "9"):
        with pytest.raises(UserError, match="max_episode_steps must be"):
            gymnasium.make_vec(ID, max_episode_steps=wrong, **SMALL)


def test_an_episode_ends_once_it_is_solved() -> None:
    env = gymnasium.make(ID, max_episode_steps=120, image_size=8)
    inner: Any = env.unwrapped
    episodes = evaluation_episodes(inner.config, 1, seed=3)
    played = play(OracleAgent(inner), inner, episodes)
    env.reset(options={"episodes": episodes})
    ends = [env.step(action)[2:4] for action in played.steps.actions]
    assert ends == [(False, False)] * (len(ends) - 1) + [(True, False)]
    with pytest.raises(UserError, match="has no running episode"):
        env.step(STILL)


def test_a_state_goes_back_beyond_the_task_s_own_limit() -> None:
    env = gymnasium.make(ID, max_episode_steps=120, **SMALL)
    env.reset(seed=0)
    for _ in range(55):
        env.step(STILL)
    inner: Any = env.unwrapped
    state = inner.get_state()
    first = env.step(STILL + 1)
    inner.set_state(state)
    again = env.step(STILL + 1)
    np.testing.assert_array_equal(first[0], again[0])
    assert first[1:4] == again[1:4]


def test_agents_play_the_limit_of_the_config_and_refuse_another() -> None:
    env = gymnasium.make(ID, **SMALL)
    config = env.unwrapped.config
    episodes = evaluation_episodes(config, 2, seed=3)
    assert play(ZeroAgent(), env, episodes).length.tolist() == [50, 50]
    for limit in (3, 120):
        other = gymnasium.make(ID, max_episode_steps=limit, **SMALL)
        with pytest.raises(UserError, match=r"max_episode_steps\), got TimeLimit"):
            play(ZeroAgent(), other, episodes)
    env = knowarm.make(ID, **SMALL, max_episode_steps=3)
    assert play(ZeroAgent(), env, episodes).length.tolist() == [3, 3]


@LIFTS
def test_a_task_with_other_steps_than_the_id_s_is_refused() -> None:
    assert gymnasium.spec("knowarm/IRB120Lift-v0").max_episode_steps == 100
    for make in (gymnasium.make, gymnasium.make_vec):
        with pytest.raises(UserError, match=r"'reach', of 50 steps, .*'lift' has 100"):
            make(ID, task="lift", image_size=8)
    choose = knowarm.AskObject(objects=3)
    other = gymnasium.make("knowarm/IRB120Choose-v0", task=choose, **SMALL)
    assert other.unwrapped.config.task.asked.visible == 3
    assert steps_of(other) == 50


def test_stable_baselines3_counts_the_same_steps() -> None:
    sb3 = pytest.importorskip("stable_baselines3.common.env_util")
    options = {"max_episode_steps": 60, **SMALL}
    envs = sb3.make_vec_env(ID, n_envs=2, seed=0, env_kwargs=options)
    envs.reset()
    for step in range(1, 61):
        _, _, dones, infos = envs.step(np.tile(STILL, (2, 1)))
        assert dones.all() == (step == 60)
    assert [info["TimeLimit.truncated"] for info in infos] == [True, True]
    assert [info["episode"]["l"] for info in infos] == [60, 60]
