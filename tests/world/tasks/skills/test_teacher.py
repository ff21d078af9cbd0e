"""Teacher: its table of solutions, its actions, and the practice starts."""

import numpy as np
import pytest

from knowarm.world.backend import MujocoSimulator
from knowarm.world.config import EnvConfig
from knowarm.world.envs.torch_env import TorchArmVectorEnv
from knowarm.world.robots import ROBOTS
from knowarm.world.tasks.reward import measure
from knowarm.world.tasks.skills.ik import InverseKinematics
from knowarm.world.tasks.skills.teacher import PRACTICE_NOISE, GoalTable, Teacher

COUNT = 256


def make_env(robot="irb120", count=COUNT, **config):
    env = TorchArmVectorEnv(EnvConfig(robot=robot, **config), count, num_threads=1)
    env.reset(seed=3)
    return env


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_interpolated_angles_reach_the_goal_frames(robot):
    env = make_env(robot)
    running = env.running
    joints = GoalTable(running)(running.objects[:, 0], running.positions[:, 0])
    simulator = MujocoSimulator(env.scene, COUNT, 1, "kinematic")
    simulator.set_joints(joints)
    distance, angle = measure(
        simulator.tcp_position,
        simulator.tcp_matrix,
        running.goal_position,
        running.goal_matrix,
        running.ignore_roll,
    )
    assert np.mean((distance < 0.01) & (angle < 3)) > 0.95
    assert np.mean((distance < 0.05) & (angle < 15)) > 0.99


def test_inverse_kinematics_is_solved_without_the_other_objects(monkeypatch):
    """With 300 objects it took 5 GB, and minutes in which no signal ended a training."""
    sizes = []

    def solve(solver, *arguments):
        sizes.append(len(solver.scene.targets))
        return before(solver, *arguments)

    before = InverseKinematics.solve
    monkeypatch.setattr(InverseKinematics, "solve", solve)
    GoalTable(make_env(count=1).running)
    assert sizes == [1, 1]


def test_similar_places_have_similar_solutions():
    """One branch per object: joints change little between neighbouring places."""
    env = make_env()
    running, table = env.running, GoalTable(env.running)
    objects = running.objects[:, 0]
    here = table(objects, running.positions[:, 0])
    beside = table(objects, running.positions[:, 0] + 0.005)
    assert np.abs(beside - here).max() < 0.2


def test_a_student_that_obeys_the_teacher_solves_the_episodes():
    env = make_env(count=64)
    solved = np.zeros(64, bool)
    for _ in range(50):
        actions, _ = env.teach()
        assert int(actions.max()) < 3
        _, _, terminated, _, _ = env.step(actions)
        solved |= terminated.numpy()
    assert solved.mean() > 0.97


def test_the_way_is_measured_from_the_joint_targets_in_largest_steps():
    env = make_env(count=4)
    _, before = env.teach()
    actions, _ = env.teach()
    env.step(actions)
    _, after = env.teach()
    change = (actions == 1).float() - (actions == 2).float()
    far = before.abs() > 1
    np.testing.assert_allclose((before - after)[far], change[far], atol=1e-5)
    assert far.any()


def test_practice_starts_lie_around_the_way_and_depend_on_the_stream_only():
    plain, moved = make_env(), make_env()
    moved.practice_share = 1.0
    other = make_env(count=32)
    other.practice_share = 1.0
    for env in (plain, moved, other):
        env.reset(seed=11)
    start, points = plain.running.joint_targets, moved.running.joint_targets
    np.testing.assert_array_equal(moved.running.positions, plain.running.positions)
    np.testing.assert_array_equal(other.running.joint_targets, points[:32])
    goals = Teacher(plain.running).goals(
        plain.running.objects[:, 0], plain.running.positions[:, 0]
    )
    step = plain.scene.robot.mpi_rad
    way = goals - start
    far = np.abs(way).argmax(axis=1)
    rows = np.arange(len(way))
    share = (points - start)[rows, far] / way[rows, far]
    assert 0.4 < share.mean() < 0.6
    assert share.std() > 0.2
    # A joint with a short way has arrived by then in most episodes.
    short = (np.abs(way) > step) & (
        np.abs(way) < 0.3 * np.abs(way).max(axis=1, keepdims=True)
    )
    late = short & (share > 0.4)[:, None]
    assert late.any()
    assert 0.5 < (points - goals)[late].std() / (PRACTICE_NOISE * step) < 2


def test_without_practice_episodes_start_as_they_are_drawn():
    plain, env = make_env(count=8), make_env(count=8)
    env.practice_share = 1.0
    env.reset(seed=1)
    env.practice_share = 0.0
    env.reset(seed=1)
    plain.reset(seed=1)
    np.testing.assert_array_equal(
        env.running.joint_targets, plain.running.joint_targets
    )
