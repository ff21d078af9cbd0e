"""Agents without eyes: the open-loop search scores lists as the environment plays them."""

import dataclasses

import numpy as np
import pytest

from knowarm.world.agents import (
    Batch,
    BlindAgent,
    FrozenAgent,
    OpenLoopAgent,
    open_loop,
)
from knowarm.world.agents.open_loop import (
    ANCHORS,
    _anchor_goals,
    search_open_loop,
)
from knowarm.world.agents.open_loop_score import OpenLoopScore
from knowarm.world.agents.play import play
from knowarm.world.agents.protocol import Observations
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.objects import TARGETS
from knowarm.world.robots import ROBOTS
from tests.world.helpers import EXAMPLES

SCARA = str(EXAMPLES / "scara.toml")  # with a slide


class ListAgent:
    """Plays a list of actions and notes the images it is given."""

    def __init__(self, actions: np.ndarray) -> None:
        self.actions = actions
        self.seen: list[np.ndarray] = []

    def reset(self, batch: Batch) -> None:
        self.num_envs = batch.size
        self.step = 0

    def act(self, observations: Observations) -> np.ndarray:
        self.seen.append(observations["image"].copy())
        self.step += 1
        return np.tile(self.actions[self.step - 1], (self.num_envs, 1))


def loose(robot: str, **fields) -> EnvConfig:
    return EnvConfig(
        robot=robot,
        dynamics="kinematic",
        image_size=4,
        success_distance_m=0.3,
        success_angle_deg=40.0 if fields.get("ignore_roll") else 75.0,
        **fields,
    )


@pytest.mark.parametrize("ignore_roll", [False, True])
@pytest.mark.parametrize("robot", [*ROBOTS, SCARA])
def test_the_score_equals_the_kinematic_environment(robot, ignore_roll):
    targets = ("bottle",) if robot == SCARA else EnvConfig().targets
    config = loose(robot, ignore_roll=ignore_roll, targets=targets, mpi_rad=0.08)
    env = ArmVectorEnv(config, 60)
    episodes = evaluation_episodes(config, 60, 0)
    score = OpenLoopScore(config, episodes)
    actions = np.random.default_rng(1).choice(
        [0, 1, 1, 2, 3], size=(50, env.scene.num_joints)
    )
    result = play(ListAgent(actions), env, episodes)
    first, _ = score.play(actions)
    assert 0 < result.success.sum() < 60
    np.testing.assert_array_equal(
        first[result.success] + 1, result.length[result.success]
    )
    np.testing.assert_array_equal(score.is_solved(first), result.success)
    changed = actions.copy()
    changed[20:] = 0
    again, _ = score.play(changed, solved_at=first, since=20)
    np.testing.assert_array_equal(again, score.play(changed)[0])
    early, half = score.play(actions[:20])
    late, _ = score.play(actions[20:], half, np.where(score.is_solved(early), -1, 0))
    np.testing.assert_array_equal(score.is_solved(late), result.success)


@pytest.fixture
def cached(tmp_path, monkeypatch):
    """A cache of its own, and a function that lists the lists in it after forgetting the rest."""
    monkeypatch.setenv("KNOWARM_CACHE", str(tmp_path))
    search_open_loop.cache_clear()

    def files():
        search_open_loop.cache_clear()
        return sorted(tmp_path.glob("open-loop/*"))

    yield files
    search_open_loop.cache_clear()


def test_the_search_is_reproducible_and_beats_standing_still(cached):
    config = EnvConfig(robot="tiago", success_distance_m=0.10, success_angle_deg=17.0)
    actions = search_open_loop(config, 600, 3)
    for file in cached():
        file.unlink()
    np.testing.assert_array_equal(actions, search_open_loop(config, 600, 3))
    assert actions.shape == (50, 7)
    env = ArmVectorEnv(EnvConfig(robot="tiago", image_size=4), 100)
    env.config = config
    episodes = evaluation_episodes(config, 100, 0)
    blind = play(
        OpenLoopAgent(search_open_loop(config, 600, 3)),
        ArmVectorEnv(config, 100),
        episodes,
    ).success.mean()
    still = play(ListAgent(np.zeros_like(actions)), ArmVectorEnv(config, 100), episodes)
    assert blind > 0.3 > still.success.mean()


def test_a_list_is_read_from_the_cache_where_the_task_is_the_same(cached):
    config = EnvConfig(targets=("mug",))
    found = search_open_loop(config, 30)
    (file,) = cached()
    mine = 6 - found
    np.savez(file, actions=mine)
    np.testing.assert_array_equal(search_open_loop(config, 30), mine)
    assert cached() == [file]
    for change in (
        {"success_distance_m": 0.09},
        {"targets": ("bottle",)},
        {"mpi_rad": 0.06},
    ):
        search_open_loop(dataclasses.replace(config, **change), 30)
    search_open_loop(config, 31)
    search_open_loop(config, 30, 1)
    assert len(cached()) == 6
    file.write_bytes(file.read_bytes()[:100])
    np.testing.assert_array_equal(search_open_loop(config, 30), found)


def test_many_targets_are_searched_in_groups(monkeypatch):
    monkeypatch.setattr(open_loop, "MOST_GROUPS", 9)
    config = EnvConfig(targets=tuple(TARGETS)[:20])
    episodes = evaluation_episodes(config, 70, 0)
    goals = _anchor_goals(OpenLoopScore(config, episodes))
    assert len(goals) == 9 * len(ANCHORS) ** 2
    assert len(np.unique(goals, axis=0)) == len(goals)


def test_a_blind_agent_sees_black_and_a_frozen_one_the_first_image():
    env = ArmVectorEnv(loose("irb120", max_episode_steps=3), 2)
    episodes = evaluation_episodes(env.config, 2, 0)
    blind, frozen, seeing = (
        ListAgent(np.ones((3, 6), dtype=np.int64)) for _ in range(3)
    )
    for _ in range(2):  # a second start forgets the first images
        play(BlindAgent(blind), env, episodes)
        play(FrozenAgent(frozen), env, episodes)
        play(seeing, env, episodes)
        episodes = episodes[np.array([1, 0])]
    assert not np.any(blind.seen)
    assert len(frozen.seen) == len(seeing.seen) == 6
    for k, image in enumerate(frozen.seen):
        np.testing.assert_array_equal(image, seeing.seen[k // 3 * 3])
    assert (seeing.seen[2] != seeing.seen[0]).any()
