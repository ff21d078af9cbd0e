import gc

import numpy as np
import psutil
import pytest

from tests.thorough import thorough
from tests.world.helpers import MakeEnv

STEPS = thorough(3_200, 6_400)  # a robot; `make torture` takes a million
MAX_GROWTH_MIB = 30


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["irb120", "tiago"])
def test_random_steps_leave_no_nan_and_no_growing_memory(
    robot: str, make_env: MakeEnv
) -> None:
    env = make_env(64, num_threads=0, robot=robot, colours="randomized")
    env.reset(seed=0)
    generator = np.random.default_rng(0)
    process = psutil.Process()
    memory, ended = [], 0
    for i in range(STEPS // env.num_envs + 1):
        actions = generator.integers(7, size=env.action_space.shape)
        observations, rewards, terminated, truncated, infos = env.step(actions)
        ended += int((terminated | truncated).sum())
        assert np.isfinite(rewards).all()
        assert np.isfinite(infos["distance"]).all()
        assert np.isfinite(infos["angle"]).all()
        assert infos["distance"].max() < 3
        if i % 50 == 0:
            assert np.isfinite(env.joint_positions).all()
            assert observations.any(axis=(1, 2, 3)).all()
            gc.collect()
            memory.append(process.memory_info().rss / 2**20)
    assert ended >= STEPS // 50 - env.num_envs
    assert memory[-1] - memory[len(memory) // 4] < MAX_GROWTH_MIB
    if hasattr(env.simulation.batch, "warning"):  # from MuJoCo 3.17 on
        assert (env.simulation.batch.warning == 0).all(), "MuJoCo warned"
