"""Inverse kinematics: poses that can be reached are reached closely."""

import numpy as np
import pytest

from knowarm.world.backend import MujocoSimulator
from knowarm.world.scene.scene import load_scene
from knowarm.world.tasks.skills.ik import InverseKinematics
from tests.world.helpers import EXAMPLES


@pytest.mark.parametrize("robot", ["irb120", "tiago", str(EXAMPLES / "scara.toml")])
def test_iterations_end_where_the_pose_is_reached(robot):
    """The third robot has a joint that slides."""
    scene = load_scene(robot, ("mug",))
    solver = InverseKinematics(scene)
    home = np.tile(scene.home, (50, 1))
    moved = home + np.random.default_rng(0).uniform(-0.3, 0.3, home.shape)
    position, matrix = solver.pose(moved.clip(scene.joint_lower, scene.joint_upper))
    found = solver.solve(position, matrix, home)
    error = np.linalg.norm(solver.pose(found.joints)[0] - position, axis=1)
    assert error.max() < 0.005  # [m]; convergence is slow near singular poses
    assert np.quantile(error, 0.7) < 2e-5
    assert np.quantile(found.angle, 0.7) < 0.01  # [deg]


def test_poses_in_the_table_are_reached_in_contact_alone():
    scene = load_scene("tiago", ("mug",))
    joints = np.random.default_rng(0).uniform(
        scene.joint_lower, scene.joint_upper, (40, scene.num_joints)
    )
    simulator = MujocoSimulator(scene, 40)
    contacts = simulator.batch.bind("ncon").reshape(-1)
    simulator.set_joints(joints)
    solver = InverseKinematics(scene, starts=1)
    found = solver.solve(*solver.pose(joints), joints, attempts=1)
    np.testing.assert_array_equal(found.contact, contacts > 0)
    assert 0 < found.contact.sum() < 40
    assert not found.within(np.inf, np.inf)[found.contact].any()
