"""Lifting task: its teacher, what ends an episode, rewards, states and restrictions."""

from dataclasses import replace

import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run import build
from knowarm.world.agents import Batch, OracleAgent, ZeroAgent
from knowarm.world.agents import open_loop as open_loop_module
from knowarm.world.agents.play import play
from knowarm.world.config import EnvConfig, scene_of
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.torch_env import TorchArmVectorEnv
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.objects import find_targets
from knowarm.world.robots import ROBOTS
from knowarm.world.tasks.skills.lift.lift import FALLEN_M, LOST_M, Lift
from knowarm.world.tasks.skills.lift.model import TIMESTEP_S, build_lift_scene
from knowarm.world.tasks.skills.lift.probe import LiftProbe
from knowarm.world.tasks.skills.lift.simulator import FAST_M_S, FINE_SUBSTEPS
from knowarm.world.tasks.skills.lift.teacher import LiftTeacher
from knowarm.world.tasks.skills.teacher import COARSE_LEVELS

COUNT = 16


def make_env(robot="irb120", count=COUNT, **options):
    config = EnvConfig(robot=robot, task=Lift(), image_size=16, **options)
    return ArmVectorEnv(config, count, num_threads=1)


def start(env, seed=0):
    env.reset(options={"episodes": evaluation_episodes(env.config, env.num_envs, seed)})


def play_oracle(env, steps):
    """Play the oracle for some steps; return the last outcome."""
    oracle = OracleAgent(env)
    oracle.reset(Batch.of(env))
    nothing = np.zeros(env.num_envs, dtype=np.bool_)
    for _ in range(steps):
        result = env.advance(oracle.act({}), nothing)
    return result


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_oracle_lifts(robot):
    env = make_env(robot)
    result = play(OracleAgent(env), env, evaluation_episodes(env.config, COUNT, 0))
    assert result.success.mean() >= 0.9
    assert (
        result.infos["rise"][result.success] >= env.config.task.skill.height_m
    ).all()
    assert result.infos["gripped"][result.success].all()
    assert np.median(result.length) < 70


@pytest.mark.parametrize("robot", ROBOTS)
def test_an_arm_that_rests_moves_no_object(robot):
    env = make_env(robot)
    start(env)
    before = env.running.positions[:, 0]
    for _ in range(10):
        _, _, terminated, _, infos = env.step(
            np.zeros(env.action_space.shape, dtype=np.int64)
        )
        assert not terminated.any()
    place = env.simulation.place(env.running.target)
    assert np.abs(place - before).max() < 0.002
    assert np.abs(infos["rise"]).max() < 0.005
    assert not infos["gripped"].any()


def test_the_fingers_are_one_more_joint():
    env = make_env()
    joints = len(env.scene.robot.joints)
    assert env.single_action_space.shape == (joints + 1,)
    assert env.scene.joint_names == (*env.scene.robot.joints, "fingers")
    start(env)
    open_m = env.joint_positions[:, -1].copy()
    action = np.zeros(env.action_space.shape, dtype=np.int64)
    action[:, -1] = 1
    env.step(action)
    env.step(action)
    closed_m = env.joint_positions[:, -1]
    assert (np.abs(open_m) < 1e-6).all()
    assert (closed_m > 0.02).all()
    action[:, -1] = 2
    env.step(action)
    env.step(action)
    assert (env.joint_positions[:, -1] < 0.005).all()


def test_hidden_objects_are_out_of_the_way_and_images_show_where_the_object_is():
    env = make_env(count=8)
    start(env)
    running, simulation = env.running, env.simulation
    other = 1 - running.target
    assert (simulation.centre(other)[:, 2] > 100).all()
    geoms = (env.scene.geom_target[:, None] == running.target).T
    before = np.where(geoms, simulation.geom_position[..., 2], 0).max(axis=1)
    assert before.max() < 1
    images = env.render()
    play_oracle(env, 48)
    risen = simulation.rise(running.target) > 0.03
    assert risen.any()
    after = np.where(geoms, simulation.geom_position[..., 2], 0).max(axis=1)
    assert (after[risen] > before[risen] + 0.02).all()
    assert all((a != b).any() for a, b in zip(images, env.render(), strict=True))


def test_hidden_objects_stay_away_however_long_the_episode_is():
    env = make_env(count=2, max_episode_steps=400)
    start(env)
    env.simulation.batch.step(nstep=400 * 25)
    assert (env.simulation.centre(1 - env.running.target)[:, 2] > 100).all()


def test_an_object_that_is_pushed_away_or_falls_ends_the_episode():
    env = make_env(count=4)
    start(env)
    task, running, simulation = env.config.task, env.running, env.simulation
    assert not task.failure(running).any()
    x = env.scene.object_qpos[running.target]
    simulation._qpos[0, x[0]] += LOST_M + 0.02
    simulation._qpos[1, x[1] + 2] -= FALLEN_M + 0.02
    simulation.batch.forward()
    assert task.failure(running).tolist() == [True, True, False, False]


def test_rewards_rise_from_the_way_to_the_grip_to_the_lift():
    env = make_env(count=8)
    start(env)
    task, running = env.config.task, env.running
    away = task.skill.reward(running)
    expected = -2 * running.distance**2 - running.angle / 70
    np.testing.assert_allclose(away, expected)
    reward, most = np.full(8, -np.inf), np.full(8, -np.inf)
    oracle = OracleAgent(env)
    oracle.reset(Batch.of(env))
    for _ in range(70):
        _, reward, _, _, infos = env.advance(
            oracle.act({}), np.zeros(8, dtype=np.bool_)
        )
        held = infos["gripped"] & ~infos["is_success"]
        rise = (infos["rise"] / task.skill.height_m).clip(0, 1)
        np.testing.assert_allclose(reward[held], 1 + 4 * rise[held])
        most = np.maximum(most, reward)
    assert (most == 100).sum() >= 7


def test_a_period_that_goes_astray_is_simulated_again_in_fine_steps(monkeypatch):
    env = make_env(count=2)
    fine = make_env(count=2)
    fine.simulation._free_substeps = FINE_SUBSTEPS
    verdicts = [np.array([False, True]), np.array([False])]
    for each in (env, fine):
        start(each)
    monkeypatch.setattr(env.simulation, "_is_astray", lambda ids: verdicts.pop(0))
    actions = np.ones(env.action_space.shape, np.int64)
    actions[:, -1] = 0
    for each in (env, fine):
        each.advance(actions, np.zeros(2, bool))
    assert not verdicts
    same = env.joint_positions == fine.joint_positions
    assert same.all(axis=1).tolist() == [False, True]
    assert not env.simulation.unstable.any()


@pytest.mark.parametrize("speed", [2 * FAST_M_S, 1e12])
def test_unstable_physics_ends_an_episode_by_its_own_name(speed, capfd):
    env = make_env(count=3)
    start(env)
    simulation = env.simulation
    simulation.batch.bind("qvel")[1, simulation._target_qvel] = speed
    nothing = np.zeros(env.action_space.shape, np.int64)
    _, _, terminated, _, infos = env.advance(nothing, np.zeros(3, bool))
    assert ("unstable" in capfd.readouterr().err) == (speed == 1e12)
    assert terminated.tolist() == [False, True, False]
    assert infos["unstable"].tolist() == [False, True, False]
    assert not infos["is_success"].any()
    assert not infos["disturbed"].any()
    skill = env.config.task.skill
    said = skill.result(env.running, env.config.task.asked, 1)
    assert said == "It is not lifted: the physics became unstable."
    state = env.get_state()
    start(env, seed=1)
    assert not simulation.unstable.any()
    env.set_state(state)
    assert simulation.unstable.tolist() == [False, True, False]
    start(env)
    simulation.batch.bind("time")[2] = 0.0  # As after a reset that left all in place
    _, _, terminated, _, _ = env.advance(nothing, np.zeros(3, bool))
    assert terminated.tolist() == [False, False, True]


def test_a_lift_has_to_last():
    env = make_env(count=8)
    task = env.config.task
    start(env)
    ended = np.zeros(8, dtype=np.bool_)
    oracle = OracleAgent(env)
    oracle.reset(Batch.of(env))
    up = np.zeros(8, dtype=np.int64)
    for _ in range(80):
        _, _, terminated, _, infos = env.advance(
            oracle.act({}), np.zeros(8, dtype=np.bool_)
        )
        up = np.where(
            infos["gripped"] & (infos["rise"] >= task.skill.height_m), up + 1, 0
        )
        new = terminated & infos["is_success"] & ~ended
        assert (up[new] == task.skill.hold_steps).all()
        ended |= terminated
    assert ended.sum() >= 7


def test_a_restored_state_continues_to_the_byte():
    env, other = make_env(count=4), make_env(count=4)
    start(env)
    play_oracle(env, 44)  # in the middle of contacts
    state = env.get_state()
    other.set_state(state)
    actions = np.random.default_rng(0).integers(0, 3, (6, *env.action_space.shape))
    for action in actions:
        mine, theirs = env.step(action), other.step(action)
        for a, b in zip(mine[:4], theirs[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(mine[4]["rise"], theirs[4]["rise"])
    np.testing.assert_array_equal(env.joint_positions, other.joint_positions)


def test_episodes_do_not_depend_on_their_neighbours():
    alone, together = make_env(count=1), make_env(count=4)
    episodes = evaluation_episodes(alone.config, 4, 0)
    alone.reset(options={"episodes": episodes[2:3]})
    together.reset(options={"episodes": episodes})
    action = np.ones(together.action_space.shape, dtype=np.int64)
    for _ in range(5):
        alone.step(action[:1])
        together.step(action)
    np.testing.assert_array_equal(alone.joint_positions[0], together.joint_positions[2])


def test_the_teacher_teaches_coarse_levels_from_practice_starts():
    config = EnvConfig(task=Lift(), image_size=16)
    env = TorchArmVectorEnv(config, 32, num_threads=1)
    env.practice_share = 1.0
    env.reset(seed=1)
    assert isinstance(env.teacher, LiftTeacher)
    actions, way = env.teach()
    assert actions.shape == way.shape == (32, env.scene.num_joints)
    assert int(actions.max()) == COARSE_LEVELS - 1
    assert (env.running.joint_targets[:, -1] == 0).all()
    near = env.running.distance < 0.1
    assert 0.2 < near.mean() < 1


def test_the_open_loop_agent_replays_a_lift(monkeypatch):
    monkeypatch.setattr(open_loop_module, "REPLAYED_LISTS", 2)
    monkeypatch.setattr(open_loop_module, "REPLAYED_EPISODES", 6)
    open_loop_module.search_open_loop.cache_clear()
    env = make_env(count=6)
    start(env)
    actions = open_loop_module.search_open_loop(env.config)
    open_loop_module.search_open_loop.cache_clear()
    assert actions.shape == (env.config.max_episode_steps, env.scene.num_joints)
    assert (actions[:, -1] == 1).any()  # closes the fingers


def test_the_policy_has_an_action_for_the_fingers_and_episodes_take_longer():
    config = experiment_config("irb120-lift-full-distil")
    assert config.env.max_episode_steps == Lift.max_steps == 100
    assert EnvConfig().max_episode_steps == 50
    names = scene_of(config.env).joint_names
    assert names == config.env.task.skill.joint_names(ROBOTS["irb120"])
    assert (
        build(config).policy_shape.joints
        == len(names)
        == len(ROBOTS["irb120"].joints) + 1
    )


def test_a_solid_scene_is_simulated_in_larger_steps():
    assert scene_of(EnvConfig(task=Lift())).model.opt.timestep == TIMESTEP_S


def test_what_a_lift_cannot_be_is_refused():
    with pytest.raises(UserError, match="cannot be simulated with kinematic"):
        EnvConfig(task=Lift(), dynamics="kinematic")
    with pytest.raises(UserError, match="names no fingers"):
        build_lift_scene(replace(ROBOTS["irb120"], fingers=()), find_targets(("mug",)))
    with pytest.raises(UserError, match="'lift' moves the fingers"):
        evaluate(ZeroAgent(), EnvConfig(task=Lift()), episodes=1, probes=(LiftProbe(),))


@pytest.mark.parametrize("field", ["height_m", "hold_steps"])
def test_a_lift_without_height_or_steps_is_refused(field):
    with pytest.raises(UserError, match=f"task.{field}"):
        Lift(**{field: 0})
