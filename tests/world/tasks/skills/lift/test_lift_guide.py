"""Guide of lifting: it goes around other objects, and what it disturbs is a failure."""

from dataclasses import replace

import numpy as np
import torch

import knowarm
from knowarm.perception.config import GroundingConfig, GroundingSpec
from knowarm.perception.grounding import GroundingNetwork
from knowarm.perception.images import axes_of
from knowarm.perception.recognition import FrameRecognition
from knowarm.perception.solving import SolvingAgent
from knowarm.world.config import questions_of, scene_of
from knowarm.world.tasks import find_task
from knowarm.world.tasks.skills.guides import Guide, Sight
from knowarm.world.tasks.skills.lift.guide import CLOSED, Surroundings
from tests.thorough import thorough

COUNT = thorough(16, 24)


def make_env(robot, count=COUNT):
    return knowarm.make(robot, num_envs=count, task="choose-lift", image_size=8)


class ShortSightedAgent(knowarm.OracleAgent):
    """Knows nothing of the objects that are not meant."""

    def reset(self, batch):
        sight = Sight.true(self._env.running)
        only = sight._replace(objects=sight.objects[:, :1], places=sight.places[:, :1])
        self.path = self.guide.path(only)


def test_the_path_goes_around_other_objects():
    env = make_env("tiago")
    episodes = knowarm.evaluation_episodes(env.config, COUNT, seed=0)
    oracle = knowarm.OracleAgent(env)
    found = knowarm.play(oracle, env, episodes)
    is_free = oracle.guide.is_free
    assert is_free.mean() >= 0.85
    assert found.success[is_free].mean() >= 0.9
    assert not found.infos["disturbed"][found.success].any()
    blind = knowarm.play(ShortSightedAgent(env), env, episodes)
    assert blind.success.sum() < found.success.sum()
    assert blind.infos["disturbed"].sum() > found.infos["disturbed"].sum()


def test_a_gripper_in_another_object_is_not_free():
    env = make_env("irb120", 4)
    env.reset(seed=1)
    state = env.running
    sight = Sight.true(state)
    surroundings = Surroundings(state.scene, sight)
    ids = np.arange(4)
    home = state.scene.home[:-1]
    assert surroundings.are_free(ids, np.tile(home, (4, 1, 1)), CLOSED[0]).all()
    other = state.grasp_positions()[:, 1]
    frames = state.scene.grasp_matrix[state.objects[:, 1]]
    other += 0.04 * frames[:, :, 2]
    matrix = frames.reshape(-1, 9)
    arm = replace(env.config, task=find_task("choose"), dynamics="kinematic")
    guide = Guide(scene_of(arm), 0.05, 15.0, False)
    sight = sight._replace(joints=sight.joints[:, :-1], position=other, matrix=matrix)
    inside = guide.path(sight).points
    assert not surroundings.are_free(ids, inside, CLOSED[0]).any()


def test_moving_another_object_ends_the_episode_without_success():
    env = make_env("irb120", 3)
    env.reset(seed=2)
    state = env.running
    state.memory["held"][:] = env.config.task.skill.hold_steps
    body = state.scene.object_qpos[state.objects[:, 1]]
    rows = np.arange(3)
    for way_m, moved in ((0.02, False), (0.04, True)):
        before = env.get_state()
        state.simulator._qpos[rows, body] = state.positions[:, 1, 0] + way_m
        state.simulator.set_joints(state.joint_targets)
        assert (env.config.task.skill.infos(state)["disturbed"] == moved).all()
        assert (env.config.task.skill.success(state) != moved).all()
        assert (env.config.task.failure(state) == moved).all()
        env.set_state(before)


class TrueRecognition(FrameRecognition):
    """Sees what the simulator knows of the episodes of an environment."""

    def __init__(self, network, env):
        super().__init__(network)
        self.state = env.running

    def locate(self, images, knowledge):
        return self.true_frames(self.state, np.arange(len(images)))

    def look_around(self, images):
        state = self.state
        facets = state.first_facet[state.objects] + state.colours
        axes = axes_of(state.scene.grasp_matrix[state.objects])
        frames = self.network.standardized(
            torch.from_numpy(state.grasp_positions()).float(),
            torch.from_numpy(axes).float(),
        )
        order = [2, 0, 1, 3]  # the one that is meant may be named in any place
        return torch.from_numpy(facets)[:, order], frames[:, order]


class TrueAgent:
    """Has no policy."""

    depends_on_rows = False

    def __init__(self, recognition):
        self.notes = {}
        self.recognition = recognition

    def reset(self, batch):
        pass

    def recognize(self, images):
        return self.recognition.locate(images, None)


def test_what_is_seen_is_lifted():
    """A network whose objects and frames are the true ones does what the oracle does."""
    env = make_env("irb120", 6)
    episodes = knowarm.evaluation_episodes(env.config, 6, seed=4)
    knowledge = np.zeros((len(questions_of(env.config).queries), 6), np.float32)
    spec = GroundingSpec.of(env.config, GroundingConfig())
    agent = TrueAgent(TrueRecognition(GroundingNetwork(spec, knowledge, 1), env))
    solving = SolvingAgent(agent, env.config)
    sights = []
    solve = solving._guide.path

    def path(sight):
        sights.append(sight)
        return solve(sight)

    solving._guide.path = path
    found = knowarm.play(solving, env, episodes)
    (sight,) = sights
    np.testing.assert_array_equal(sight.objects[:, 0], episodes.target)
    np.testing.assert_allclose(sight.places[:, 0], episodes.position, atol=1e-5)
    np.testing.assert_array_equal(
        np.sort(sight.objects, axis=1), np.sort(episodes.objects, axis=1)
    )
    oracle = knowarm.play(knowarm.OracleAgent(env), env, episodes)
    np.testing.assert_array_equal(found.success, oracle.success)
    np.testing.assert_array_equal(found.length, oracle.length)
