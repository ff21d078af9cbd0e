import numpy as np
import pytest

from knowarm.world.config import EnvConfig, scene_of
from knowarm.world.envs.episodes import draw_episodes, evaluation_episodes
from knowarm.world.robots import ROBOTS
from knowarm.world.tasks.sampling import Episodes


def draw(config: EnvConfig, count: int, stream: int = 5) -> Episodes:
    return draw_episodes(
        config, np.full(count, stream, np.uint64), np.arange(count, dtype=np.uint64)
    )


@pytest.mark.parametrize("robot", ROBOTS)
def test_episodes_fill_the_paper_s_ranges(robot: str) -> None:
    config = EnvConfig(robot=robot, colours="randomized")
    scene, episodes = scene_of(config), draw(config, 4000)
    centre = np.array(scene.robot.rectangle_centre_m)
    half = np.array(scene.robot.rectangle_half_size_m)
    offset = (episodes.position - centre) / half
    assert offset.min() > -1
    assert offset.max() < 1
    assert np.abs(offset.mean(axis=0)).max() < 0.05
    assert (np.bincount(episodes.target) > 4000 / 3 * 0.9).all()
    assert (np.bincount(episodes.target * 2 + episodes.colour) > 4000 / 6 * 0.85).all()

    # joints 1 and 2 from U(.15 lower, .15 upper), the others at home
    angles = scene.home + episodes.joint_offsets
    for j in (0, 1):
        lowest, highest = 0.15 * scene.joint_lower[j], 0.15 * scene.joint_upper[j]
        width = highest - lowest
        assert lowest - 1e-3 <= angles[:, j].min() < lowest + 0.01 * width
        assert highest - 0.01 * width < angles[:, j].max() <= highest + 1e-3
    assert (episodes.joint_offsets[:, 2:] == 0).all()


def test_fixed_colours_are_the_first() -> None:
    assert (draw(EnvConfig(), 100).colour == 0).all()


def test_a_longer_evaluation_list_begins_with_the_shorter() -> None:
    short = evaluation_episodes(EnvConfig(), 10, 3)
    long = evaluation_episodes(EnvConfig(), 25, 3)
    assert (long[:10].position == short.position).all()
    assert (long[:10].joint_offsets == short.joint_offsets).all()
    other = evaluation_episodes(EnvConfig(), 10, 4)
    assert (other.position != short.position).all()


def test_episodes_are_picked_like_an_array() -> None:
    episodes = draw(EnvConfig(), 12)
    mug = episodes[episodes.target == 0]
    assert len(mug) == (episodes.target == 0).sum()
    assert (episodes[np.array([3, 1])].position == episodes.position[[3, 1]]).all()
