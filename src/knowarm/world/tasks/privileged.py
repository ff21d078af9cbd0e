"""Privileged state: what the simulator knows about an episode, for training only."""

from typing import TYPE_CHECKING

from knowarm.world.arrays import Array, array_namespace

if TYPE_CHECKING:
    from knowarm.world.tasks.reach import ReachTask


def privileged_columns(num_joints: int) -> tuple[str, ...]:
    """Name the columns of the privileged state, ``<quantity>/<index>``, in their order.

    All quantities are those after the last step. Positions and rotations are in world coordinates
    unless a name says ``in_gripper``; rotations are row-major matrices.

    ===================  =====  ==============================================================
    quantity             width  meaning
    ===================  =====  ==============================================================
    joint_position       J      angles of the joints [rad]
    gripper_position     3      position of the gripper [m]
    grasp_position       3      position of the target's grasp frame [m]
    gripper_to_grasp     3      difference of the two [m]
    grasp_matrix         9      rotation from grasp frame to world
    gripper_matrix       9      rotation from gripper to world
    joint_target         J      angles that the servos track [rad]
    position_in_gripper  3      position of the grasp frame in the gripper's frame [m]
    matrix_in_gripper    9      rotation from grasp frame to gripper
    distance             1      from gripper to grasp frame [m]
    angle                1      between gripper and grasp frame [deg]
    time                 1      steps played over the time limit, 0 to 1
    ===================  =====  ==============================================================

    Args:
        num_joints: J.
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


def privileged_state(task: "ReachTask") -> Array:
    """Return the privileged state of n episodes, (n, D); see `privileged_columns`.

    Returns:
        NumPy array or tensor of the simulator's precision.
    """
    simulator = task.simulator
    xp = array_namespace(simulator.tcp_position)
    gripper = xp.reshape(simulator.tcp_matrix, (-1, 3, 3))
    grasp = xp.reshape(task.grasp_matrix, (-1, 3, 3))
    difference = task.grasp_position - simulator.tcp_position
    # Products and sums instead of matrix products, which a GPU may round to TF32.
    position = xp.sum(gripper * difference[:, :, None], axis=1)
    rotation = xp.sum(gripper[:, :, :, None] * grasp[:, :, None, :], axis=1)
    real = difference.dtype
    time = xp.astype(task.steps, real) / task.config.max_episode_steps
    return xp.concat(
        (
            simulator.joint_positions,
            simulator.tcp_position,
            task.grasp_position,
            difference,
            task.grasp_matrix,
            simulator.tcp_matrix,
            task.joint_targets,
            position,
            xp.reshape(rotation, (-1, 9)),
            task.distance[:, None],
            task.angle[:, None],
            time[:, None],
        ),
        axis=1,
    )
