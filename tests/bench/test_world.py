"""Tests of ``benchmarks/world.py`` with tiny sizes."""

import pytest

from benchmarks.world import WorldBenchConfig, bench_world
from knowarm.errors import UserError

TINY = {"num_envs": 4, "seconds": 0.05, "robots": ("irb120",), "image_size": 16}


def test_every_kind_of_dynamics_is_measured() -> None:
    seen: list = []
    table = bench_world(WorldBenchConfig(scaling=False, **TINY), seen.append)
    assert [(row["task"], row["dynamics"]) for row in table["rows"]] == [
        ("reach", "dynamic"),
        ("reach", "kinematic"),
        ("choose", "dynamic"),
    ]
    assert table["rows"] == seen
    assert all(row["steps_per_s"] > 0 for row in table["rows"])
    assert {row["antialiasing"] for row in table["raycaster"]} == {False, True}
    assert all(row["frames_per_s_core"] > 0 for row in table["raycaster"])
    assert table["scaling"] == []


def test_sizes_out_of_range_are_refused() -> None:
    with pytest.raises(UserError, match="workers must be at least 1, got 0"):
        WorldBenchConfig(workers=0)
