import torch

from knowarm.learn.rollout import EpisodeStatistics


def statistics_and_add():
    """Create statistics of two environments, and a function that adds a step to them."""
    statistics = EpisodeStatistics(2, torch.device("cpu"))

    def add(reward, done=(False, False), success=(False, False)):
        kinds = (torch.float64, torch.bool, torch.bool)
        values = zip((reward, done, success), kinds, strict=True)
        statistics.add(*(torch.tensor(value, dtype=kind) for value, kind in values))

    return statistics, add


def test_returns_and_lengths_of_whole_episodes():
    statistics, add = statistics_and_add()
    add([1.0, 2.0])
    add([1.0, 5.0], done=[False, True], success=[True, True])
    add([1.0, 4.0], done=[True, False])
    finished = statistics.take()
    assert finished.episode_return.tolist() == [7.0, 3.0]
    assert finished.length.tolist() == [2, 3]
    assert finished.success.tolist() == [True, False]
    assert finished.summary() == {
        "episodes": 2, "return_mean": 5.0, "length_mean": 2.5, "success": 0.5,
    }  # fmt: skip
    assert statistics.take().summary() == {"episodes": 0}


def test_running_sums_survive_a_stop():
    first, add = statistics_and_add()
    add([1.0, 2.0])
    first.take()
    second, add = statistics_and_add()
    second.set_state(first.get_state())
    add([1.0, 2.0], done=[True, True])
    assert second.take().episode_return.tolist() == [2.0, 4.0]


def test_rewards_are_summed_in_double_precision():
    statistics = EpisodeStatistics(1, torch.device("cpu"))
    rewards, done = [1e8, 0.1, -1e8], torch.tensor([False])
    for reward in rewards:
        statistics.add(torch.tensor([reward], dtype=torch.float64), done, done)
    statistics.add(torch.zeros(1), ~done, done)
    # Rounded after each addition, unlike the built-in sum of Python 3.12.
    assert statistics.take().episode_return[0] == (1e8 + 0.1) - 1e8
