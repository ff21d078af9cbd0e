"""The example ``so101_reach``: success needs a gripper that stands still."""

from pathlib import Path

import numpy as np
import pytest

from knowarm.world.agents import OracleAgent
from knowarm.world.agents.play import play_steps
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.task import Task

FOLDER = Path(__file__).parents[2] / "examples" / "so101_reach"


def played(task: Task) -> tuple[np.ndarray, np.ndarray]:
    """Return for each step of the oracle whether the gripper is near, and whether it succeeded."""
    config = EnvConfig(
        task=task,
        targets=(str(FOLDER / "cube.toml"),),
        success_distance_m=0.1,
        success_angle_deg=179.0,
        ignore_roll=True,
        image_size=1,
    )
    env = ArmVectorEnv(config, 16, num_threads=1)
    steps = list(play_steps(OracleAgent(env), env, evaluation_episodes(config, 16, 0)))[
        1:
    ]
    near = np.stack([(step.infos["distance"] < 0.1) & step.played for step in steps])
    solved = np.stack([step.infos["is_success"] & step.played for step in steps])
    return near, solved


def test_success_needs_a_gripper_that_stands_still(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(FOLDER))
    from steady import Steady  # type: ignore[import-not-found]

    near, solved = played(Task())
    assert np.array_equal(near, solved)
    near, solved = played(Steady(joints=6))
    assert (near & ~solved).any()
    assert solved.any(axis=0).all()
