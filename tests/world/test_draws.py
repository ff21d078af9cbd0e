import numpy as np
from scipy import stats

from knowarm.world.tasks.sampling import derive, uniforms


def numbers(streams: list[int], episodes: list[int], count: int = 8) -> np.ndarray:
    return uniforms(np.array(streams, np.uint64), np.array(episodes, np.uint64), count)


def test_the_hash_is_splitmix64() -> None:
    # stream 0 of the reference generator begins 0xE220A8397B1DCDAF: the finalizer of one gamma
    from knowarm.world.tasks.sampling import _mix

    assert hex(int(_mix(np.array([0], np.uint64))[0])) == "0xe220a8397b1dcdaf"


def test_a_draw_depends_on_its_three_numbers_only() -> None:
    many = numbers([1, 2, 3, 3], [0, 0, 0, 1])
    for row, (stream, episode) in zip(
        many, [(1, 0), (2, 0), (3, 0), (3, 1)], strict=True
    ):
        assert (numbers([stream], [episode])[0] == row).all()
    assert (numbers([3], [1], 3)[0] == many[3, :3]).all()


def test_draws_are_uniform_and_independent_across_streams_episodes_and_draws() -> None:
    grid = np.stack([numbers([s] * 500, list(range(500)), 4) for s in range(20)])
    assert stats.kstest(grid.ravel(), "uniform").pvalue > 1e-3
    for axis in range(3):
        one = np.take(grid, range(grid.shape[axis] - 1), axis).ravel()
        two = np.take(grid, range(1, grid.shape[axis]), axis).ravel()
        assert abs(np.corrcoef(one, two)[0, 1]) < 0.02


def test_derived_seeds_are_far_from_the_streams_of_training() -> None:
    seeds = {
        derive(seed, label) for seed in range(100) for label in ("evaluation", "other")
    }
    assert len(seeds) == 200
    assert min(seeds) > 2**40
