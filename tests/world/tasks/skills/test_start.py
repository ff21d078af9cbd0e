"""The start of an episode: its distance from the grasps, free of collisions, in the image."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import knowarm
from knowarm.errors import UserError
from knowarm.experiment.names import experiment_config
from knowarm.world.agents import OracleAgent
from knowarm.world.agents.play import play
from knowarm.world.config import EnvConfig, scene_of
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.robots import ROBOTS
from knowarm.world.robots.robot import Area
from knowarm.world.scene.scene import Scene, _load_scene, load_scene, project
from knowarm.world.tasks.reward import measure
from knowarm.world.tasks.skills.reach import Reach

starts = pytest.mark.parametrize(
    "start", [Reach(), Reach(start="near")], ids=["far", "near"]
)


def start_poses(scene: Scene, count: int = 9) -> np.ndarray:
    """Joint angles over the whole range of starts, (count**2, J)."""
    first, second = scene.robot.start_joints
    reach = scene.robot.start_fraction * (scene.joint_upper - scene.joint_lower) / 2
    steps = np.linspace(-1, 1, count)
    poses = np.tile(scene.home, (count**2, 1))
    poses[:, first] += np.repeat(steps, count) * reach[first]
    poses[:, second] += np.tile(steps, count) * reach[second]
    return np.clip(poses, scene.joint_lower, scene.joint_upper)


def collisions(
    model: mujoco.MjModel, scene: Scene, poses: np.ndarray
) -> list[set[tuple]]:
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
    config = EnvConfig(robot=robot, image_size=8)  # which the oracle does not see
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
def test_from_the_near_start_the_oracle_is_soon_at_the_object_and_then_turns(robot):
    env = knowarm.make(robot, num_envs=300, task=Reach(start="near"), image_size=8)
    results = play(OracleAgent(env), env, evaluation_episodes(env.config, 300, seed=5))
    assert results.success.mean() >= 0.99
    steps = results.steps
    near = steps.distance < 0.10
    at = np.full(300, 99)
    np.minimum.at(at, steps.episode[near], steps.step[near])
    assert 4 <= np.median(at) <= 7
    assert 8 <= np.median(results.length) <= 12
    assert np.percentile(results.length, 95) <= 18


def test_the_papers_a3c_starts_near_and_everything_else_far():
    assert experiment_config("irb120-full-a3c").env.task.skill == Reach(start="near")
    for algorithm in ("fast", "distil", "ppo", "a3c-tuned"):
        assert experiment_config(f"irb120-full-{algorithm}").env.task.skill == Reach()


def test_an_area_changes_what_it_names_and_a_robot_without_a_near_start_is_refused(
    monkeypatch,
):
    robot = ROBOTS["irb120"]
    area = Area(home=(0.1,) * 6, target_yaws_deg={"mug": 5.0})
    monkeypatch.setitem(ROBOTS, "irb120", replace(robot, areas={"near": area}))
    scene = load_scene("irb120", ("mug",), area="near")
    assert (scene.robot.home, scene.robot.mpi_rad) == (area.home, robot.mpi_rad)
    yaws = {name: scene.robot.yaw_deg(name) for name in ("mug", "bottle")}
    assert yaws == {"mug": 5.0, "bottle": robot.yaw_deg("bottle")}
    monkeypatch.setitem(ROBOTS, "irb120", replace(robot, areas={}))
    with pytest.raises(UserError, match=r"no near start.*\[areas.near\].*start='far'"):
        knowarm.make("irb120", task=Reach(start="near"))
    with pytest.raises(
        UserError, match=r"areas\.near: Robot 'irb120': home has 1 values"
    ):
        replace(robot, areas={"near": Area(home=(0.1,))})


@starts
@pytest.mark.parametrize("robot", ROBOTS)
def test_no_start_collides(robot, start):
    scene = scene_of(EnvConfig(robot=robot, task=start))
    model = scene.model
    for geom in range(model.ngeom):  # let the robot collide with itself as well
        if model.body(model.geom_bodyid[geom]).name.startswith("robot/"):
            model.geom_contype[geom] = model.geom_conaffinity[geom] = 3
            body = model.geom_bodyid[geom]
            model.body_contype[body] = model.body_conaffinity[body] = 3
    _load_scene.cache_clear()  # the model was changed
    poses = start_poses(scene)
    generator = np.random.default_rng(0)
    others = []  # the same first joints, whose range is the paper's, with any other joints
    for _ in range(10):
        other = generator.uniform(scene.joint_lower, scene.joint_upper, poses.shape)
        other[:, scene.robot.start_joints] = poses[:, scene.robot.start_joints]
        others.append(collisions(model, scene, other))
    # What always touches are envelopes of the torso and the first links.
    always = [set.intersection(*pairs) for pairs in zip(*others, strict=True)]
    for pairs, allowed in zip(collisions(model, scene, poses), always, strict=True):
        assert pairs <= allowed


@starts
@pytest.mark.parametrize("robot", ROBOTS)
def test_the_gripper_starts_in_the_image(robot, start):
    scene = scene_of(EnvConfig(robot=robot, task=start))
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
    assert measure(position, matrix, position, other, True)[1][0] == pytest.approx(
        0, abs=1e-5
    )
