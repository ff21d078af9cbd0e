"""Privileged state: what the simulator knows about an episode, for training only."""

import numpy as np

from knowarm.arrays import Floats
from knowarm.world.envs.running import RunningEpisodes


def privileged_columns(state: RunningEpisodes) -> tuple[str, ...]:
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
    columns: list[str] = []
    for name, values in _quantities(state).items():
        columns += [f"{name}/{i}" for i in range(values.shape[1])]
    return tuple(columns)


def privileged_state(state: RunningEpisodes) -> Floats:
    """Return the privileged state of n episodes, (n, D); see `privileged_columns`."""
    return np.concat(list(_quantities(state).values()), axis=1)


def _quantities(state: RunningEpisodes) -> dict[str, Floats]:
    simulator = state.simulator
    gripper = simulator.tcp_matrix.reshape(-1, 3, 3)
    grasp = state.goal_matrix.reshape(-1, 3, 3)
    difference = state.goal_position - simulator.tcp_position
    rotation = (gripper[:, :, :, None] * grasp[:, :, None, :]).sum(axis=1)
    return {
        "joint_position": simulator.joint_positions,
        "gripper_position": simulator.tcp_position,
        "grasp_position": state.goal_position,
        "gripper_to_grasp": difference,
        "grasp_matrix": state.goal_matrix,
        "gripper_matrix": simulator.tcp_matrix,
        "joint_target": state.joint_targets,
        "position_in_gripper": (gripper * difference[:, :, None]).sum(axis=1),
        "matrix_in_gripper": rotation.reshape(-1, 9),
        "distance": state.distance[:, None],
        "angle": state.angle[:, None],
        "time": (state.steps / state.config.max_episode_steps)[:, None],
    }
