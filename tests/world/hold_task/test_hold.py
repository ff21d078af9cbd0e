"""A skill with physics, fingers and a teacher is one class outside the package."""

import numpy as np
import pytest

import knowarm
from knowarm.world.agents import Batch

PLACE = "tests.world.hold_task.hold:Hold"


@pytest.fixture
def hold(monkeypatch):
    monkeypatch.setenv("KNOWARM_TASKS", "")
    monkeypatch.setitem(knowarm.SKILLS, "hold", PLACE)
    return knowarm.register_task(PLACE)


def test_its_teacher_lifts_and_holds(hold):
    env = knowarm.make("irb120", num_envs=16, task="hold", image_size=16)
    assert env.action_space.shape == (16, 7)
    episodes = knowarm.evaluation_episodes(env.config, 16, seed=0)
    result = knowarm.play(knowarm.OracleAgent(env), env, episodes)
    assert result.success.mean() >= 0.9
    assert (
        result.infos["held"][result.success] == env.config.task.skill.hold_steps
    ).all()
    steps = result.steps
    rewards = steps.reward[steps.episode == int(np.flatnonzero(result.success)[0])]
    assert (np.diff(rewards[-20:]) > 0).all()  # the second phase
    assert rewards[-1] > 100


def test_opening_the_fingers_in_the_second_phase_ends_the_episode(hold):
    env = knowarm.make(
        "irb120", num_envs=4, task=PLACE, image_size=16, observe=("joints",)
    )
    agent = knowarm.OracleAgent(env)
    env.reset(seed=1)
    agent.reset(Batch.of(env))
    for _ in range(100):
        actions = agent.act({})
        up = env.running.memory["held"] >= 5
        actions[up, -1] = 2
        _, _, terminated, _, infos = env.step(actions)
        if terminated.any():
            break
    assert not infos["final_info"]["is_success"][terminated].any()
    assert env.get_state()["memory.lifted"].dtype == np.bool_


def test_it_is_trained_and_evaluated_by_its_name(hold, tmp_path):
    run = knowarm.train(
        "irb120-hold-full-distil",
        total_steps=64,
        runs=tmp_path,
        env={"image_size": 20},
        algorithm={"num_envs": 8, "rollout_steps": 4, "minibatches": 2, "processes": 1},
        interim={"episodes": 2},
    )
    result = knowarm.evaluate(run, episodes=2, probes=())
    assert 0 <= result.summary["success"] <= 1
    assert knowarm.load_agent(run.folder.path).policy.shape.joints == 7
