import numpy as np
import pytest

from knowarm.bench.mjwarp_renderer import MjWarpRenderer
from knowarm.bench.world import WorldBenchConfig, bench_world
from knowarm.errors import UserError
from knowarm.world.config import EnvConfig
from knowarm.world.vector_env import ReachVectorEnv

TINY = {"num_envs": 4, "seconds": 0.05, "robots": ("irb120",), "image_size": 16}


def test_ours_alone_is_measured_without_other_packages() -> None:
    seen: list = []
    table = bench_world(
        WorldBenchConfig(opengl=False, mjwarp=False, growth=False, **TINY), seen.append
    )
    assert [row["dynamics"] for row in table["rows"]] == ["dynamic", "kinematic"]
    assert table["rows"] == seen
    assert all(row["steps_per_s"] > 100 for row in table["rows"])
    assert {row["antialiasing"] for row in table["raycaster"]} == {False, True}
    assert all(row["frames_per_s_core"] > 100 for row in table["raycaster"])


def test_shares_that_do_not_come_out_even_are_refused() -> None:
    with pytest.raises(UserError, match=r"num_envs \(5\) must be a multiple of workers \(2\)"):
        WorldBenchConfig(num_envs=5)


@pytest.mark.slow
def test_mujoco_warp_draws_the_same_scene() -> None:
    pytest.importorskip("mujoco_warp")
    env = ReachVectorEnv(EnvConfig(antialiasing=False), 3)
    ours, _ = env.reset(seed=2)
    env.renderer = MjWarpRenderer(env.scene, 64, 3)
    theirs, _ = env.reset(seed=2)
    assert np.abs(ours.astype(int) - theirs).mean() < 6
    assert (np.abs(ours.astype(int) - theirs).max(axis=-1) > 60).mean() < 0.03
