"""The example ``so101_place``: one jaw closes on a fixed one, and the cube ends on a drawn disc."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.world.agents.play import play_steps
from knowarm.world.agents.scripted import TeacherAgent
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.robots import find_robot
from knowarm.world.tasks.task import Task

FOLDER = Path(__file__).parents[2] / "examples" / "so101_place"
EPISODES = 16


def test_a_cube_is_put_on_a_disc_by_a_jaw_that_closes_on_a_fixed_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(FOLDER))
    from disc import APART_M, OnDisc  # type: ignore[import-not-found]

    config = EnvConfig(
        robot=str(FOLDER / "so101.toml"),
        targets=(str(FOLDER / "cube.toml"),),
        task=Task(skill=OnDisc()),
        image_size=1,
    )
    env = ArmVectorEnv(config, EPISODES, num_threads=1)
    simulator = env.running.simulator
    model = env.running.scene.model
    jaws = [model.joint(name).qposadr[0] for name in ("left", "right")]
    ways = []
    solved = np.zeros(EPISODES, bool)
    for step in play_steps(
        TeacherAgent(env), env, evaluation_episodes(config, EPISODES, 0)
    ):
        ways.append(simulator.batch.bind("qpos")[:, jaws].copy())
        solved |= step.infos["is_success"] & step.played
        is_near = step.infos["tray_distance"] <= 0.025
        assert (is_near | ~step.infos["is_success"]).all()
    moving, fixed = np.abs(ways).max(axis=(0, 1))
    assert moving > 0.02
    assert fixed < 0.002
    assert solved.mean() > 0.9
    disc = simulator.batch.bind("mocap_pos")[:, 0, :2]
    assert np.allclose(disc, env.running.memory["destination"])
    apart = np.linalg.norm(disc - env.running.positions[:, 0], axis=1)
    assert apart.min() > APART_M


@pytest.mark.parametrize("shares", [(1.0, 0.5), (0.0, 1.0), (1.5, -0.5)])
def test_shares_of_the_gap_add_up_to_it(shares: tuple[float, float]) -> None:
    robot = find_robot(str(FOLDER / "so101.toml"))
    with pytest.raises(UserError, match="must add up to 1"):
        replace(robot, finger_shares=shares)
