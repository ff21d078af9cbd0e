"""Placing: what counts as placed, what ends an episode, and the oracle that does it."""

from dataclasses import replace

import numpy as np
import pytest

import knowarm
from knowarm.errors import UserError
from knowarm.world.agents import Batch
from knowarm.world.agents.scripted import TeacherAgent
from knowarm.world.config import scene_of
from knowarm.world.robots import ROBOTS, find_robot
from knowarm.world.tasks import find_task
from knowarm.world.tasks.skills.guides import Guide, Sight
from knowarm.world.tasks.skills.lift.guide import Surroundings
from knowarm.world.tasks.skills.place.place import OUTCOMES, Place
from knowarm.world.tasks.skills.place.tray import HALF_M
from knowarm.world.tasks.skills.teacher import COARSE_LEVELS
from knowarm.world.tasks.state import ACTION_LEVELS, nearest_levels
from tests.thorough import thorough

OPEN = 2  # Level of the largest step that opens the fingers


def make_env(robot="irb120", count=8, task="place"):
    return knowarm.make(robot, num_envs=count, task=task, image_size=8)


def begin(env, seed=0):
    episodes = knowarm.evaluation_episodes(env.config, env.num_envs, seed)
    env.reset(options={"episodes": episodes})


def started(env, seed=0):
    begin(env, seed)
    agent = knowarm.OracleAgent(env)
    agent.reset(Batch.of(env))
    return agent


def nothing(env):
    return np.zeros(env.num_envs, bool)


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_oracle_places_objects_on_the_tray(robot):
    env = make_env(robot)
    episodes = knowarm.evaluation_episodes(env.config, 8, seed=0)
    result = knowarm.play(knowarm.OracleAgent(env), env, episodes)
    assert result.success.mean() >= 0.85
    assert (result.infos["placing"][result.success] == "placed").all()
    assert (result.infos["tray_distance"][result.success] < HALF_M * 2**0.5).all()
    assert not result.infos["gripped"][result.success].any()


def followed(guide, sight, steps=150):
    """Return the joint targets of arms that follow their paths, (n, steps, J)."""
    path = guide.path(sight)
    targets = sight.joints.copy()
    levels = 0.05 * np.array(ACTION_LEVELS)
    passed = []
    for _ in range(steps):
        targets = targets + levels[nearest_levels(path.error(targets))]
        passed.append(targets)
    return np.stack(passed, axis=1)


def test_a_path_does_not_depend_on_the_other_arms_of_its_batch():
    env = make_env(count=3, task="choose-place")
    agent = started(env)
    sight = Sight.true(env.running)
    together = followed(agent.guide, sight)
    for number in range(3):
        rows = {
            name: values[number : number + 1]
            for name, values in sight._asdict().items()
            if values is not None
        }
        (alone,) = followed(agent.guide, sight._replace(**rows))
        np.testing.assert_array_equal(alone, together[number])


def test_holding_on_over_the_tray_returns_less_than_letting_go():
    """Otherwise the network with the best return is one that never lets go."""

    class Holder(Student):
        def act(self, observations):
            actions = super().act(observations)
            is_taken = self._env.running.memory["taken"]
            actions[is_taken & (actions[:, -1] == OPEN), -1] = 0
            return actions

    env = make_env("tiago", count=6)
    episodes = knowarm.evaluation_episodes(env.config, 6, seed=0)
    placed = knowarm.play(Student(env), env, episodes)
    held = knowarm.play(Holder(env), env, episodes)
    assert placed.success.sum() >= 4
    assert not held.success.any()
    assert held.infos["gripped"].sum() >= 4
    both = placed.success & held.infos["gripped"]
    assert (placed.episode_return[both] > held.episode_return[both]).all()


def test_of_several_objects_the_oracle_places_the_one_that_answers():
    count = thorough(8, 12)
    env = make_env(count=count, task="choose-place")
    episodes = knowarm.evaluation_episodes(env.config, count, seed=0)
    result = knowarm.play(knowarm.OracleAgent(env), env, episodes)
    assert result.success.mean() >= 0.75
    assert not result.infos["disturbed"][result.success].any()
    assert set(result.infos["placing"]) <= set(OUTCOMES)


def test_what_is_let_go_on_the_way_is_no_success():
    env = make_env()
    agent = started(env)
    ended = {}
    for _ in range(140):
        actions = agent.act({})
        offset = env.running.infos()["tray_distance"]
        dropping = env.running.memory["taken"] & (offset > 2 * HALF_M)
        actions[dropping, -1] = OPEN
        _, _, terminated, _, infos = env.advance(actions, nothing(env))
        for number in np.flatnonzero(terminated):
            ended.setdefault(int(number), infos["placing"][number])
        assert not infos["is_success"][dropping].any()
    assert len(ended) >= 6
    assert set(ended.values()) <= {"beside", "fallen"}
    assert "beside" in ended.values()


def test_what_is_held_over_the_tray_is_not_placed_yet():
    env = make_env()
    agent = started(env)
    held = nothing(env)
    for _ in range(120):
        actions = agent.act({})
        over = env.running.infos()["tray_distance"] < HALF_M / 2
        held |= over & env.running.memory["taken"]
        actions[over, -1] = 1  # The fingers stay closed.
        _, _, _terminated, _, infos = env.advance(actions, nothing(env))
        assert not infos["is_success"].any()
    assert held.sum() >= 6


def test_taking_another_object_ends_the_episode():
    env = make_env(count=4, task="choose-place")
    env.reset(seed=3)
    state = env.running
    agent = knowarm.OracleAgent(env)
    agent.reset(Batch.of(env))
    state.objects = np.roll(state.objects, -1, axis=1)
    state.positions = np.roll(state.positions, -1, axis=1)
    ended = nothing(env)
    for _ in range(90):
        _, _, terminated, _, infos = env.advance(agent.act({}), nothing(env))
        ended |= terminated
        assert not infos["is_success"].any()
    assert ended.sum() >= 3


def test_unstable_physics_is_an_end_of_its_own():
    env = make_env(count=3, task="choose-place")
    begin(env)
    simulation = env.simulation
    simulation.batch.bind("qvel")[1, simulation._target_qvel] = 1e12
    actions = np.zeros(env.action_space.shape, np.int64)
    _, _, terminated, _, infos = env.advance(actions, nothing(env))
    assert terminated.tolist() == [False, True, False]
    assert infos["placing"].tolist() == ["unfinished", "unstable", "unfinished"]
    assert not infos["disturbed"].any()
    assert "unstable" in Place().result(env.running, env.config.task.asked, 1)


def test_a_restored_state_continues_to_the_byte():
    env = make_env(count=4)
    agent = started(env)
    for _ in range(60):
        env.advance(agent.act({}), nothing(env))
    state = env.get_state()
    actions = np.ones((4, 7), np.int64)
    first = [env.advance(actions, nothing(env))[1] for _ in range(5)]
    env.set_state(state)
    again = [env.advance(actions, nothing(env))[1] for _ in range(5)]
    np.testing.assert_array_equal(first, again)


def test_what_is_held_may_touch_nothing_either():
    """Above another object there is a height that is free without what the gripper holds."""
    env = make_env(count=6, task="choose-place")
    begin(env)
    state = env.running
    sight = Sight.true(state)
    arm = replace(env.config, task=find_task("choose"), dynamics="kinematic")
    guide = Guide(scene_of(arm), 0.05, 15.0, False)
    joints = sight._replace(joints=sight.joints[:, :-1])
    alone = Surroundings(state.scene, sight)
    holding = Surroundings(state.scene, sight)
    holding.hold(guide.path(joints).points[:, 0])
    ids = np.arange(6)
    differs = nothing(env)
    for height in np.arange(0.04, 0.24, 0.04):
        above = state.grasp_positions()[:, 1] + [0, 0, height]
        pose = guide.path(joints._replace(position=above)).points
        is_free = holding.are_free(ids, pose, 0.0)
        assert not (is_free & ~alone.are_free(ids, pose, 0.0)).any()
        differs |= alone.are_free(ids, pose, 0.0) & ~is_free
    assert differs.sum() >= 3


def test_a_robot_without_a_tray_is_refused_with_a_remedy():
    robot = replace(find_robot("irb120"), trays_m=())
    with pytest.raises(UserError, match=r"Set trays_m = "):
        Place().area_of(robot)


class Student(TeacherAgent):
    """Obeys the teacher, by the largest steps alone."""

    def act(self, observations):
        return nearest_levels(self.teacher.error(), COARSE_LEVELS)


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_student_that_obeys_the_teacher_places_an_object_that_stands_alone(robot):
    env = make_env(robot, count=16)
    episodes = knowarm.evaluation_episodes(env.config, 16, seed=0)
    result = knowarm.play(Student(env), env, episodes)
    assert result.success.mean() >= 0.8
    assert (result.infos["tray_distance"][result.success] < HALF_M * 2**0.5).all()
