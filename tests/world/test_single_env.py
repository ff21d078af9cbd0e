import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from knowarm.errors import UserError
from knowarm.world import env_id, make
from knowarm.world.envs.single_env import ArmEnv
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.robots import ROBOTS
from knowarm.world.tasks.state import ACTION_LEVELS


@pytest.mark.parametrize("env_id", [env_id(robot) for robot in ROBOTS])
def test_gymnasium_s_checker_passes_without_a_warning(env_id: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(env_id, render_mode="rgb_array")
        check_env(env.unwrapped)


@pytest.mark.parametrize("env_id", [env_id(robot) for robot in ROBOTS])
def test_stable_baselines3_s_checker_passes_without_a_warning(env_id: str) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(gymnasium.make(env_id).unwrapped)
        shown = {"observe": ("image", "joints", "knowledge"), "knowledge": np.eye(3)}
        checker.check_env(
            gymnasium.make(env_id, action="continuous", **shown).unwrapped
        )


def test_make_vec_gives_our_own_vector() -> None:
    env = gymnasium.make_vec(
        "knowarm/TiagoReach-v0", num_envs=3, image_size=16, colours="randomized"
    )
    assert isinstance(env.unwrapped, ArmVectorEnv)
    assert env.unwrapped.config.robot == "tiago"
    observations, _ = env.reset(seed=0)
    assert observations.shape == (3, 16, 16, 3)


def test_render_gives_a_large_image() -> None:
    env = gymnasium.make(
        "knowarm/IRB120Reach-v0", image_size=16, render_mode="rgb_array"
    )
    env.reset(seed=0)
    image = env.render()
    assert isinstance(image, np.ndarray)
    assert image.shape == (480, 480, 3)
    assert image.dtype == np.uint8
    with pytest.raises(
        UserError, match="render_mode must be 'rgb_array' or None, got 'human'"
    ):
        ArmEnv(render_mode="human")


def test_an_unseeded_environment_is_not_the_same_every_time() -> None:
    starts = {
        gymnasium.make("knowarm/IRB120Reach-v0", image_size=8).reset()[1]["distance"]
        for _ in range(3)
    }
    assert len(starts) == 3


def test_knowledge_of_the_running_episode_stands_beside_the_image() -> None:
    table = np.arange(12).reshape(6, 2)
    shown = {"observe": ("image", "knowledge"), "knowledge": table}
    env = gymnasium.make(
        "knowarm/IRB120Reach-v0", image_size=16, colours="randomized", **shown
    )
    for seed in range(5):
        observation, info = env.reset(seed=seed)
        assert env.observation_space.contains(observation)
        assert (observation["knowledge"] == table[env.unwrapped.knowledge_input]).all()
        assert info["facet"] == "/".join(
            env.unwrapped.facets[env.unwrapped.knowledge_input]
        )
    rows = "one row for each of the 3 values of the info 'facet', which begin with 'mug/red'"
    with pytest.raises(UserError, match=rows):
        make("irb120", **shown)
    with pytest.raises(UserError, match="name it in observe"):
        make("irb120", knowledge=table)
    with pytest.raises(UserError, match="Unknown part of an observation 'picture'"):
        make("irb120", observe=("picture",))
    with pytest.raises(UserError, match="Unknown kind of action 'torque'"):
        make("irb120", action="torque")
    with pytest.raises(UserError, match="Leave out observe, knowledge, or device"):
        make("irb120", 2, "cpu", **shown)


@pytest.mark.parametrize("robot", ROBOTS)
def test_continuous_actions_are_joint_steps_in_units_of_the_mpi(robot: str) -> None:
    levels = make(robot, 3, image_size=8)
    steps = make(robot, 3, image_size=8, action="continuous", observe=("joints",))
    levels.reset(seed=0)
    steps.reset(seed=0)
    chosen = np.random.default_rng(0).integers(7, size=(5, *levels.action_space.shape))
    for actions in chosen:
        levels.step(actions)
        observed = steps.step(np.array(ACTION_LEVELS, np.float32)[actions])[0]
        np.testing.assert_allclose(steps.joint_targets, levels.joint_targets, atol=1e-6)
        assert list(observed) == ["joints"]
        np.testing.assert_allclose(
            observed["joints"], levels.joint_positions, atol=1e-5
        )
    for wrong, message in (
        (
            np.full(steps.action_space.shape, 1.1),
            r"floats from -1 to 1 .*got 1\.1 to 1\.1",
        ),
        (np.full(steps.action_space.shape, np.nan), "floats from -1 to 1 .*got nan"),
        (np.zeros(steps.action_space.shape, int), "must be floats"),
    ):
        with pytest.raises(UserError, match=message):
            steps.step(wrong)


def test_an_id_and_another_task_are_refused() -> None:
    assert (
        make("knowarm/IRB120Choose-v0", task="choose", image_size=8).config.task.name
        == "choose"
    )
    with pytest.raises(UserError, match="names the task 'reach', and task is 'choose'"):
        make("knowarm/IRB120Reach-v0", task="choose")
    with pytest.raises(UserError, match="names the task 'choose', and task is 'reach'"):
        make("knowarm/IRB120Choose-v0", task="reach")


def test_final_observations_carry_the_knowledge_of_the_episode_that_ended() -> None:
    table = np.arange(6).reshape(6, 1)
    env = gymnasium.make_vec(
        "knowarm/IRB120Reach-v0",
        num_envs=16,
        image_size=8,
        colours="randomized",
        max_episode_steps=2,
        autoreset_mode=AutoresetMode.SAME_STEP,
        observe=("image", "joints", "knowledge"),
        knowledge=table,
    )
    observations, infos = env.reset(seed=0)
    assert env.observation_space.contains(observations)
    before, joints = env.unwrapped.knowledge_input, observations["joints"]
    for _ in range(2):
        observations, _, _, truncated, infos = env.step(env.action_space.sample() * 0)
    assert truncated.all()
    after = env.unwrapped.knowledge_input
    assert (after != before).any()
    assert (observations["knowledge"][:, 0] == after).all()
    assert [final["knowledge"][0] for final in infos["final_obs"]] == before.tolist()
    last = np.stack([final["joints"] for final in infos["final_obs"]])
    assert (
        np.abs(last - joints).max()
        < 0.01
        < np.abs(observations["joints"] - joints).max()
    )


def test_importing_the_package_imports_no_simulator() -> None:
    code = "import sys, knowarm; sys.exit('mujoco' in sys.modules or 'numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
