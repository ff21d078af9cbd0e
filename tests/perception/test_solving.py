"""See, then solve: what the network sees, and inverse kinematics in place of a policy."""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import torch

from knowarm.errors import UserError
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.evaluation import SeenTest
from knowarm.experiment.load import load_agent
from knowarm.perception.images import axes_of
from knowarm.perception.solving import SolvingAgent
from knowarm.world.agents import Batch, OracleAgent
from knowarm.world.agents.play import play
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv

ZOO = Path(__file__).parents[2] / "zoo"
RUN = ZOO / "irb120-choose-answers-fast"
BRIEF = {"episodes": 48, "distance_m": 0.05, "angle_deg": 15.0, "probes": ()}


@pytest.fixture(scope="module")
def trained():
    return load_agent(RUN)


def test_what_is_seen_is_reached_more_often_than_at_random_and_less_than_by_the_oracle(
    trained, tmp_path
):
    seen = evaluate(trained, test=(SeenTest(),), write=False, **BRIEF)
    again = evaluate(trained, test=(SeenTest(),), write=False, **BRIEF)
    policy = evaluate(trained, write=False, **BRIEF)
    assert seen.summary.label == "post-training-greedy-seen"
    np.testing.assert_array_equal(seen.episodes["return"], again.episodes["return"])
    assert (seen.episodes["return"] != policy.episodes["return"]).any()
    assert 0.6 < seen.summary["success"] < 1
    assert seen.summary["choice"] > 0.85


def test_with_true_frames_it_does_what_the_oracle_does(trained):
    agent = SolvingAgent(trained.agent, trained.config.env)
    with closing(ArmVectorEnv(trained.config.env, 8)) as env:
        episodes = evaluation_episodes(env.config, 8, 3)
        oracle = play(OracleAgent(env), env, episodes)
        agent.agent.recognize = lambda images: true_frames(trained, env)
        found = play(agent, env, episodes)
        del agent.agent.recognize
    np.testing.assert_array_equal(found.length, oracle.length)
    np.testing.assert_allclose(found.episode_return, oracle.episode_return, atol=1)


def true_frames(trained, env):
    state = env.running
    axes = axes_of(state.goal_matrix.reshape(-1, 3, 3))
    position = torch.from_numpy(state.goal_position).float()
    return trained.network.standardized(position, torch.from_numpy(axes).float())


def test_poses_are_the_frames_that_the_network_states(trained):
    agent = SolvingAgent(trained.agent, trained.config.env)
    rng = np.random.default_rng(0)
    matrices, _ = np.linalg.qr(rng.normal(size=(5, 3, 3)))
    matrices *= np.sign(np.linalg.det(matrices))[:, None, None]
    places = rng.normal(size=(5, 3))
    frames = trained.network.standardized(
        torch.from_numpy(places), torch.from_numpy(axes_of(matrices))
    )
    position, matrix = agent.poses(frames)
    np.testing.assert_allclose(position, places, atol=1e-6)
    np.testing.assert_allclose(matrix.reshape(-1, 3, 3), matrices, atol=1e-6)


@pytest.mark.parametrize(
    ("run", "message"),
    [
        ("irb120-full-fast", "has no grounding network"),
        ("tiago-lift-full-distil", "has no grounding network"),
    ],
)
def test_without_a_network_that_sees_frames_nothing_is_solved(run, message):
    with pytest.raises(UserError, match=message):
        evaluate(ZOO / run, test=(SeenTest(),), write=False, **BRIEF)


def test_an_agent_of_another_task_is_refused(trained):
    agent = SolvingAgent(trained.agent, trained.config.env)
    other = load_agent(ZOO / "tiago-choose-answers-fast").config.env
    with closing(ArmVectorEnv(other, 1)) as env:
        env.reset(seed=0)
        with pytest.raises(UserError, match="tiago"):
            agent.reset(Batch.of(env))
