import numpy as np
import pytest

from knowarm.learn.schedule import step_size
from knowarm.learn.statistics import EpisodeStatistics

NO = np.zeros(2, bool)


def test_returns_and_lengths_of_whole_episodes():
    statistics = EpisodeStatistics(2)
    statistics.add(np.array([1.0, 2.0]), NO, NO, {})
    infos = {"final_info": {"is_success": np.array([False, True])}}
    statistics.add(np.array([1.0, 5.0]), np.array([False, True]), NO, infos)
    statistics.add(np.array([1.0, 4.0]), NO, np.array([True, False]), {})
    finished = statistics.take()
    assert finished.episode_return.tolist() == [7.0, 3.0]
    assert finished.length.tolist() == [2, 3]
    assert finished.success.tolist() == [True, False]
    assert finished.summary() == {
        "episodes": 2, "return_mean": 5.0, "length_mean": 2.5, "success": 0.5,
    }  # fmt: skip
    assert statistics.take().summary() == {"episodes": 0}


def test_running_sums_survive_a_stop():
    first, second = EpisodeStatistics(2), EpisodeStatistics(2)
    first.add(np.array([1.0, 2.0]), NO, NO, {})
    second.set_state(first.get_state())
    second.add(np.array([1.0, 2.0]), NO, ~NO, {})
    assert second.take().episode_return.tolist() == [2.0, 4.0]


@pytest.mark.parametrize(
    ("schedule", "expected"),
    [("constant", [2, 2, 2]), ("linear", [2, 1.1, 0.2]), ("cosine", [2, 1.1, 0.2])],
)
def test_step_sizes(schedule, expected):
    got = [step_size(schedule, 2.0, 0.1, progress) for progress in (0.0, 0.5, 1.5)]
    assert got == pytest.approx(expected)
