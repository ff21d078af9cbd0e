"""Privileged state: each column against an independent computation."""

import numpy as np
import torch

from knowarm.world.config import EnvConfig
from knowarm.world.envs.torch_env import TorchArmVectorEnv


def moved_env(**config):
    env = TorchArmVectorEnv(EnvConfig(image_size=8, **config), 4, num_threads=1)
    env.reset(seed=3)
    for seed in range(3):
        actions = torch.randint(
            0, 7, (4, 6), generator=torch.Generator().manual_seed(seed)
        )
        env.step(actions)
    return env


def by_name(env):
    """Return the columns of the privileged state grouped by quantity, name -> (n, width)."""
    state, groups = env.privileged_state.numpy(), {}
    for i, name in enumerate(env.privileged_columns):
        groups.setdefault(name.split("/")[0], []).append(state[:, i])
    return {name: np.stack(columns, 1) for name, columns in groups.items()}


def test_columns_are_what_their_names_say():
    env = moved_env()
    task, columns = env.running, by_name(env)
    position = task.simulator.tcp_position
    gripper = task.simulator.tcp_matrix.reshape(-1, 3, 3)
    goal_position = task.goal_position
    grasp = task.goal_matrix.reshape(-1, 3, 3)
    expected = {
        "joint_position": env.joint_positions.numpy(),
        "gripper_position": position,
        "grasp_position": goal_position,
        "gripper_to_grasp": goal_position - position,
        "grasp_matrix": grasp.reshape(-1, 9),
        "gripper_matrix": gripper.reshape(-1, 9),
        "joint_target": env.joint_targets.numpy(),
        "position_in_gripper": np.stack(
            [m.T @ d for m, d in zip(gripper, goal_position - position, strict=True)]
        ),
        "matrix_in_gripper": np.stack(
            [(m.T @ g).ravel() for m, g in zip(gripper, grasp, strict=True)]
        ),
        "distance": np.linalg.norm(goal_position - position, axis=1)[:, None],
        "angle": task.angle[:, None],
        "time": np.full((4, 1), 3 / 50),
    }
    assert list(columns) == list(expected)
    for name, values in expected.items():
        np.testing.assert_allclose(
            columns[name], values, rtol=1e-5, atol=1e-5, err_msg=name
        )


def test_the_number_of_columns_follows_from_the_joints():
    for robot, columns in (("irb120", 54), ("tiago", 56)):
        env = TorchArmVectorEnv(EnvConfig(robot=robot, image_size=8), 1, num_threads=1)
        assert len(env.privileged_columns) == env.privileged_state.shape[1] == columns


def test_final_states_are_those_before_the_reset():
    env = moved_env(max_episode_steps=4)
    still = torch.zeros(4, 6, dtype=torch.int64)
    assert "final_privileged_state" not in env.step(still)[-1]
    env.report_privileged_state = True
    for _ in range(3):
        env.step(still)
    before = env.privileged_state
    final = env.step(still)[-1]["final_privileged_state"]
    time = env.privileged_columns.index("time/0")
    assert (final[:, time] == 1).all()
    assert (env.privileged_state[:, time] == 0).all()
    grasp = env.privileged_columns.index("grasp_position/0")
    torch.testing.assert_close(final[:, grasp], before[:, grasp])
    assert not torch.equal(env.privileged_state[:, grasp], before[:, grasp])
