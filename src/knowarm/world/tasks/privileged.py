"""Privileged state: what the simulator knows about an episode, for training only."""

import numpy as np
from numpy.typing import NDArray

from knowarm.world.tasks.running import RunningEpisodes


def privileged_columns(num_joints: int) -> tuple[str, ...]:
    """Name the columns of the privileged state, ``<quantity>/<index>``, in their order.

    All quantities are those after the last step. Positions and rotations are in world coordinates
    unless a name says ``in_gripper``; rotations are row-major matrices.

    ===================  =====  ==============================================================
    quantity             width  meaning
    ===================  =====  ==============================================================
    joint_position       J      angles of the joints [rad]
    gripper_position     3      position of the gripper [m]
    grasp_position       3      position of the goal frame [m]
    gripper_to_grasp     3      difference of the two [m]
    grasp_matrix         9      rotation from goal frame to world
    gripper_matrix       9      rotation from gripper to world
    joint_target         J      angles that the servos track [rad]
    position_in_gripper  3      position of the goal frame in the gripper's frame [m]
    matrix_in_gripper    9      rotation from goal frame to gripper
    distance             1      from gripper to goal frame [m]
    angle                1      between gripper and goal frame [deg]
    time                 1      steps played over the time limit, 0 to 1
    ===================  =====  ==============================================================
    """
    widths = {
        "joint_position": num_joints,
        "gripper_position": 3,
        "grasp_position": 3,
        "gripper_to_grasp": 3,
        "grasp_matrix": 9,
        "gripper_matrix": 9,
        "joint_target": num_joints,
        "position_in_gripper": 3,
        "matrix_in_gripper": 9,
        "distance": 1,
        "angle": 1,
        "time": 1,
    }
    return tuple(f"{name}/{i}" for name, width in widths.items() for i in range(width))


def privileged_state(state: RunningEpisodes) -> NDArray[np.float64]:
    """Return the privileged state of n episodes, (n, D); see `privileged_columns`."""
    simulator = state.simulator
    gripper = simulator.tcp_matrix.reshape(-1, 3, 3)
    grasp = state.goal_matrix.reshape(-1, 3, 3)
    difference = state.goal_position - simulator.tcp_position
    position = (gripper * difference[:, :, None]).sum(axis=1)
    rotation = (gripper[:, :, :, None] * grasp[:, :, None, :]).sum(axis=1)
    time = state.steps / state.config.max_episode_steps
    return np.concat(
        (
            simulator.joint_positions,
            simulator.tcp_position,
            state.goal_position,
            difference,
            state.goal_matrix,
            simulator.tcp_matrix,
            state.joint_targets,
            position,
            rotation.reshape(-1, 9),
            state.distance[:, None],
            state.angle[:, None],
            time[:, None],
        ),
        axis=1,
    )
