"""The start of an episode is far from every grasp, free of collisions, and in the image."""

import mujoco
import numpy as np
import pytest

from knowarm.world.agents import OracleAgent
from knowarm.world.agents.play import play
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.robots import ROBOTS
from knowarm.world.scene.scene import Scene, _load_scene, load_scene, project
from knowarm.world.tasks.reward import measure

TARGETS = EnvConfig().targets


def start_poses(scene: Scene, count: int = 9) -> np.ndarray:
    """Joint angles over the whole range of starts, (count**2, J)."""
    first, second = scene.robot.start_joints
    reach = scene.robot.start_fraction * (scene.joint_upper - scene.joint_lower) / 2
    steps = np.linspace(-1, 1, count)
    poses = np.tile(scene.home, (count**2, 1))
    poses[:, first] += np.repeat(steps, count) * reach[first]
    poses[:, second] += np.tile(steps, count) * reach[second]
    return np.clip(poses, scene.joint_lower, scene.joint_upper)


def collisions(model: mujoco.MjModel, scene: Scene, poses: np.ndarray) -> list[set[tuple]]:
    """Pairs of geoms that touch in each pose."""
    data = mujoco.MjData(model)
    found = []
    for pose in poses:
        data.qpos[scene.qpos_index] = pose
        mujoco.mj_fwdPosition(model, data)
        pairs = data.contact.geom[data.contact.dist < 0]
        found.append({tuple(sorted(pair)) for pair in pairs.tolist()})
    return found


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_start_is_far_from_every_grasp_and_the_oracle_needs_half_the_episode(robot):
    config = EnvConfig(robot=robot)
    env = ArmVectorEnv(config, 100)
    episodes = evaluation_episodes(config, 300, seed=5)
    for first in range(0, 300, 100):
        _, infos = env.reset(options={"episodes": episodes[first : first + 100]})
        assert infos["angle"].min() > 55  # degrees; success requires less than 15
    results = play(OracleAgent(env), env, episodes)
    assert results.success.mean() >= 0.99
    for k in range(3):
        assert 20 <= np.median(results.length[episodes.target == k]) <= 25


@pytest.mark.parametrize("robot", ROBOTS)
def test_no_start_collides(robot):
    scene = load_scene(robot, TARGETS)
    model = scene.model
    for geom in range(model.ngeom):  # let the robot collide with itself as well
        if model.body(model.geom_bodyid[geom]).name.startswith("robot/"):
            model.geom_contype[geom] = model.geom_conaffinity[geom] = 3
            body = model.geom_bodyid[geom]
            model.body_contype[body] = model.body_conaffinity[body] = 3
    _load_scene.cache_clear()  # the model was changed
    starts = start_poses(scene)
    generator = np.random.default_rng(0)
    others = []  # the same first joints, whose range is the paper's, with any other joints
    for _ in range(10):
        poses = generator.uniform(scene.joint_lower, scene.joint_upper, starts.shape)
        poses[:, scene.robot.start_joints] = starts[:, scene.robot.start_joints]
        others.append(collisions(model, scene, poses))
    # What always touches are envelopes of the torso and the first links.
    always = [set.intersection(*pairs) for pairs in zip(*others, strict=True)]
    for pairs, allowed in zip(collisions(model, scene, starts), always, strict=True):
        assert pairs <= allowed


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_gripper_starts_in_the_image(robot):
    scene = load_scene(robot, TARGETS)
    data = mujoco.MjData(scene.model)
    for pose in start_poses(scene):
        data.qpos[scene.qpos_index] = pose
        mujoco.mj_kinematics(scene.model, data)
        assert np.abs(project(scene, data.site_xpos[[scene.tcp_site]])).max() < 0.95


def test_a_turned_grasp_is_as_far_and_turned_half_about_the_approach():
    turned = load_scene("tiago", ("mug",))
    position, matrix = turned.grasp_position, turned.grasp_matrix.reshape(-1, 9)
    other = (turned.grasp_matrix * [-1, -1, 1]).reshape(-1, 9)
    distance, angle = measure(position, matrix, position, other, False)
    assert (distance[0], angle[0]) == pytest.approx((0, 180))
    assert measure(position, matrix, position, other, True)[1][0] == pytest.approx(0, abs=1e-5)
