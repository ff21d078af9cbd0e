from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import FrameStackObservation
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import knowarm
from knowarm.errors import UserError
from knowarm.world.agents.play import play
from knowarm.world.agents.scripted import (
    OracleAgent,
    RandomAgent,
    TeacherAgent,
    ZeroAgent,
)
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.robots import ROBOTS
from tests.world.helpers import MakeEnv


@pytest.mark.parametrize("target", EnvConfig().targets)
@pytest.mark.parametrize("robot", ROBOTS)
def test_the_oracle_solves_every_task(
    robot: str, target: str, make_env: MakeEnv
) -> None:
    env = make_env(40, robot=robot, targets=(target,), image_size=8, num_threads=0)
    result = play(OracleAgent(env), env, evaluation_episodes(env.config, 40, seed=1))
    assert result.success.mean() >= 0.97
    assert (result.distance[result.success] < 0.05).all()
    assert (result.angle[result.success] < 15).all()


def test_a_random_agent_does_not(make_env: MakeEnv) -> None:
    env = make_env(60, image_size=8)
    episodes = evaluation_episodes(env.config, 60, seed=1)
    result = play(RandomAgent(0), env, episodes)
    assert result.success.mean() < 0.05
    assert (result.length[~result.success] == 50).all()
    assert (play(RandomAgent(0), env, episodes).distance == result.distance).all()


def test_chunks_of_any_size_give_the_same_result(make_env: MakeEnv) -> None:
    results = []
    for num_envs in (3, 7, 10):
        env = make_env(num_envs, colours="randomized")
        episodes = evaluation_episodes(env.config, 10, seed=2)
        results.append(play(OracleAgent(env), env, episodes, record_images=4))
    for other in results[1:]:
        for name in ("episode_return", "length", "distance", "success"):
            assert (getattr(results[0], name) == getattr(other, name)).all()
        assert results[0].infos.keys() == other.infos.keys()
        for name, values in other.infos.items():
            assert (results[0].infos[name] == values).all(), name
        assert (results[0].steps.joint_positions == other.steps.joint_positions).all()
        for one, two in zip(results[0].images, other.images, strict=True):
            assert (one == two).all()


class Numbering(RandomAgent):
    """Reports the number of the environment in each episode, which no two at once share."""

    def reset(self, batch):
        super().reset(batch)
        self.notes = {"number": np.arange(batch.size)}


@pytest.mark.parametrize(
    ("task", "agent"), [("reach", OracleAgent), ("lift", TeacherAgent)]
)
def test_physics_of_ended_episodes_stops_and_changes_nothing(
    task: str, agent: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = EnvConfig(robot="tiago", task=task)
    env = ArmVectorEnv(config, 4)
    episodes = evaluation_episodes(config, 6, 0)
    advance = ArmVectorEnv.advance
    simulated = []

    def counted(self: Any, actions: Any, active: Any, ids: Any = None) -> Any:
        simulated.append(ids.sum())
        return advance(self, actions, active, ids)

    monkeypatch.setattr(ArmVectorEnv, "advance", counted)
    ending = play(agent(env), env, episodes)
    assert sum(simulated) == ending.length.sum() < 4 * len(simulated)

    def without(self: Any, actions: Any, active: Any, ids: Any = None) -> Any:
        return advance(self, actions, active)

    monkeypatch.setattr(ArmVectorEnv, "advance", without)
    going_on = play(agent(env), env, episodes)
    for name, values in vars(going_on.steps).items():
        np.testing.assert_array_equal(vars(ending.steps)[name], values)
    for name, values in going_on.infos.items():
        np.testing.assert_array_equal(ending.infos[name], values)


def test_notes_of_an_agent_are_those_of_each_episode(make_env: MakeEnv) -> None:
    env = make_env(4, image_size=8)
    episodes = evaluation_episodes(env.config, 6, seed=3)
    assert play(RandomAgent(0), env, episodes).notes == {}
    notes = play(Numbering(0), env, episodes).notes
    assert notes["number"].tolist() == [0, 1, 2, 3, 0, 1]


def test_the_step_table_holds_every_step_of_every_episode(make_env: MakeEnv) -> None:
    env = make_env(4)
    episodes = evaluation_episodes(env.config, 6, seed=3)
    result = play(OracleAgent(env), env, episodes, record_images=2)
    steps = result.steps
    assert (np.bincount(steps.episode) == result.length).all()
    for i in range(6):
        rows = steps.episode == i
        assert (steps.step[rows] == np.arange(1, result.length[i] + 1)).all()
        assert steps.reward[rows].sum() == pytest.approx(result.episode_return[i])
        assert steps.distance[rows][-1] == result.distance[i]
    assert [len(film) for film in result.images] == (result.length[:2] + 1).tolist()


def test_zero_stays_at_the_start(make_env: MakeEnv) -> None:
    env = make_env(2, max_episode_steps=5)
    episodes = evaluation_episodes(env.config, 2, seed=3)
    result = play(ZeroAgent(), env, episodes)
    assert result.steps.joint_positions == pytest.approx(
        np.repeat(env.scene.home + episodes.joint_offsets, 5, axis=0), abs=1e-6
    )


def test_single_environments_are_played_as_vector_ones() -> None:
    vector = knowarm.make("irb120", 3, image_size=16)
    episodes = evaluation_episodes(vector.config, 4, seed=3)
    expected = play(OracleAgent(vector), vector, episodes)
    for env in (
        knowarm.make("irb120", image_size=16),
        gymnasium.make("knowarm/IRB120Reach-v0", image_size=16),
        gymnasium.make("knowarm/IRB120Reach-v0", image_size=16).unwrapped,
    ):
        alone = play(OracleAgent(env), env, episodes)
        assert (alone.steps.actions == expected.steps.actions).all()
        assert (alone.episode_return == expected.episode_return).all()


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: FrameStackObservation(knowarm.make("irb120"), 2), "FrameStackObs"),
        (lambda: gymnasium.make("knowarm/IRB120Reach-v0", max_episode_steps=3), "Time"),
        (lambda: RecordEpisodeStatistics(knowarm.make("irb120", 2)), "RecordEpisode"),
        (lambda: knowarm.make("irb120", 2, "cpu"), "TorchArmVectorEnv"),
        (lambda: gymnasium.make("CartPole-v1"), "CartPoleEnv|TimeLimit"),
        (lambda: "irb120", "str"),
    ],
)
def test_what_no_agent_can_play_is_refused_in_one_line(make: Any, name: str) -> None:
    episodes = evaluation_episodes(EnvConfig(), 1, seed=3)
    for use in (lambda env: play(ZeroAgent(), env, episodes), OracleAgent):
        with pytest.raises(UserError, match=f"Agents play an ArmEnv .*got ({name})"):
            use(make())
