"""Choose task: layouts, balance, infos, and agents that know or do not know the query."""

import warnings
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from numpy.typing import NDArray
from stable_baselines3.common import env_checker

import knowarm
from knowarm.errors import UserError
from knowarm.world import env_id
from knowarm.world.agents.play import EpisodeResults, play
from knowarm.world.agents.protocol import Batch, Observations
from knowarm.world.agents.scripted import OracleAgent
from knowarm.world.config import EnvConfig, questions_of, scene_of, setting_of
from knowarm.world.envs.episodes import EpisodeSource, evaluation_episodes
from knowarm.world.envs.torch_env import TorchArmVectorEnv
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.render.cpu import Raycaster
from knowarm.world.robots import ROBOTS
from knowarm.world.tasks.asked.part.part import AskPart
from knowarm.world.tasks.asked.query.arrangements import Arrangements, arrange
from knowarm.world.tasks.asked.query.layouts import support
from knowarm.world.tasks.asked.query.query import AskObject
from knowarm.world.tasks.asked.query.query_source import NameQueries
from knowarm.world.tasks.skills.guides import Sight

STREAMS = np.arange(200, dtype=np.uint64)
NUMBERS = STREAMS % np.uint64(7)
SECOND_TRY = 26
"""Step at which an agent that tries objects goes to the next one: half of an episode."""

METRICS = (
    "distance",
    "reached_object",
    "is_right_object",
    "query",
    "objects",
    "object_positions",
)


def small(robot: str = "irb120", **options: Any) -> EnvConfig:
    defaults: dict[str, Any] = {
        "task": AskObject(),
        "image_size": 8,
        "dynamics": "kinematic",
    }
    return EnvConfig(robot=robot, **(defaults | options))


def arranged(config: EnvConfig) -> Arrangements:
    assert isinstance(config.task.asked, AskObject)
    setting, task = setting_of(config), config.task.asked
    return arrange(setting.scene, task.questions(setting.facets), task.objects)


class PickingAgent(OracleAgent):
    """Moves to one of the visible objects, which it draws: it knows no query."""

    def reset(self, batch: Batch) -> None:
        super().reset(batch)
        count = self._env.running.objects.shape[1]
        self._go_to(np.random.default_rng(self._seed).integers(count, size=batch.size))

    def _go_to(self, pick: NDArray[np.int64]) -> None:
        """Move to one of the visible objects of each episode, the wanted one being 0."""
        env = self._env
        rows = np.arange(env.num_envs)
        target = env.running.objects[rows, pick]
        grasp = env.running.grasp_positions()[rows, pick]
        matrix = env.scene.grasp_matrix[target].reshape(-1, 9)
        sight = Sight.true(env.running)._replace(position=grasp, matrix=matrix)
        self.path = self.guide.path(sight)


class TryingAgent(PickingAgent):
    """Moves to another object first, and to the wanted one after that."""

    def reset(self, batch: Batch) -> None:
        super().reset(batch)
        self._go_to(np.ones(batch.size, dtype=np.int64))
        self._step = 0

    def act(self, observations: Observations) -> NDArray[np.int64]:
        self._step += 1
        if self._step == SECOND_TRY:
            self._go_to(np.zeros(self._env.num_envs, dtype=np.int64))
        return super().act(observations)


def played(kind: type[OracleAgent], config: EnvConfig, count: int) -> EpisodeResults:
    env = ArmVectorEnv(config, count)
    return play(kind(env), env, evaluation_episodes(config, count, seed=1))


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_oracle_reaches_the_object_of_the_query(robot: str) -> None:
    result = played(OracleAgent, small(robot), 60)
    assert result.infos["is_right_object"].mean() >= 0.98
    assert result.success.mean() >= 0.97


def test_an_agent_that_does_not_know_the_query_stays_at_chance() -> None:
    count, chance = 100, 0.25
    result = played(PickingAgent, small(), count)
    correct = result.infos["is_right_object"].mean()
    assert abs(correct - chance) < 3 * np.sqrt(chance * (1 - chance) / count)
    assert result.success.mean() < 0.4


def test_whoever_reaches_another_object_gets_no_second_try() -> None:
    result = played(TryingAgent, small(), 40)
    at_another = ~result.infos["is_right_object"]
    assert at_another.mean() > 0.8
    assert (result.length[at_another] < SECOND_TRY).mean() > 0.9
    assert not result.success[at_another].any()


def test_larger_thresholds_of_training_do_not_hold_for_other_objects() -> None:
    config = small()
    env = ArmVectorEnv(config, 30)
    episodes = evaluation_episodes(config, 30, seed=1)
    results = []
    for factor in (1.0, 3.0):
        env.running.threshold_factor = factor
        results.append(play(TryingAgent(env), env, episodes))
    at_another = ~results[0].success & ~results[1].success
    assert at_another.mean() > 0.5
    assert (results[0].length == results[1].length)[at_another].all()


@pytest.mark.parametrize("robot", ROBOTS)
def test_objects_do_not_overlap_and_stay_in_the_rectangle(robot: str) -> None:
    config = small(robot)
    scene = scene_of(config)
    episodes = EpisodeSource(config)(STREAMS, NUMBERS)
    position, objects = episodes.positions, episodes.objects
    inside = (
        np.abs(position - scene.robot.rectangle_centre_m)
        <= scene.robot.rectangle_half_size_m
    )
    assert inside.all()
    assert (np.sort(objects)[:, 1:] != np.sort(objects)[:, :-1]).all(), "all different"
    angles = np.linspace(0, np.pi, 16, endpoint=False)
    axes = np.stack([np.cos(angles), np.sin(angles), np.zeros(16)], axis=1)
    ahead, behind = support(scene, axes), support(scene, -axes)
    for i in range(4):
        for j in range(i):
            way = (position[:, i] - position[:, j]) @ axes[:, :2].T
            a, b = objects[:, i], objects[:, j]
            apart = (way > ahead[b] + behind[a]) | (-way > ahead[a] + behind[b])
            assert apart.any(axis=1).all()


@pytest.mark.parametrize("robot", ROBOTS)
def test_most_of_every_object_is_visible_beside_the_others(robot: str) -> None:
    count = 40
    env = ArmVectorEnv(small(robot), count)
    env.reset(seed=0)
    scene, running = env.scene, env.running
    raycaster = Raycaster(scene.model, scene.camera, 64, 64)
    poses = env.simulation.geom_position, env.simulation.geom_matrix
    rgba = env.running.shown.rgba
    together = raycaster.trace(*poses, rgba).geom
    owner = np.append(scene.geom_target, -1)  # -1, no geom, belongs to no target
    shares = []
    for j in range(4):
        own = running.objects[:, j]
        alone = rgba.copy()
        alone[..., 3] = np.where(
            (scene.geom_target >= 0) & (scene.geom_target != own[:, None]),
            0,
            alone[..., 3],
        )
        seen = owner[raycaster.trace(*poses, alone).geom] == own[:, None, None]
        left = owner[together] == own[:, None, None]
        shares.append(left.sum(axis=(1, 2)) / np.maximum(1, seen.sum(axis=(1, 2))))
    assert np.quantile(shares, 0.01) > 0.4
    assert np.mean(shares) > 0.9


def test_only_the_query_tells_which_object_is_meant() -> None:
    config = small(task=AskObject(queries=NameQueries()))
    chosen, table = arranged(config).sets, questions_of(config)
    assert chosen.balanced
    sets, number = np.unique(chosen.facets, axis=0, return_inverse=True)
    asked = np.zeros(sets.shape, dtype=int)
    np.add.at(asked, (number.reshape(-1), chosen.goal), 1)
    assert (asked == asked[:, :1]).all(), (
        "each object of a set is asked for equally often"
    )
    satisfied = table.satisfies[chosen.query[:, None], chosen.facets]
    assert (satisfied.sum(axis=1) == 1).all(), "exactly one object satisfies the query"
    assert satisfied[np.arange(len(chosen)), chosen.goal].all()
    assert np.bincount(chosen.query, minlength=len(table.queries)).min() > 0


def test_a_split_that_asks_for_few_facets_draws_the_question_first() -> None:
    class OneAnswer(NameQueries):
        def table(self, facets: Any, objects: int) -> Any:
            table = super().table(facets, objects)
            askable = table.askable.copy()
            askable[:, 1:] = False
            return replace(table, askable=askable)

    config = small(task=AskObject(queries=OneAnswer()))
    chosen, table = arranged(config).sets, questions_of(config)
    assert not chosen.balanced
    assert (chosen.facets[np.arange(len(chosen)), chosen.goal] == 0).all()
    satisfied = table.satisfies[chosen.query[:, None], chosen.facets]
    assert (satisfied.sum(axis=1) == 1).all()


def test_tensors_show_the_same_images() -> None:
    config = small(image_size=32)
    arrays, tensors = ArmVectorEnv(config, 3), TorchArmVectorEnv(config, 3)
    images, infos = arrays.reset(seed=5)
    torch_images, torch_infos = tensors.reset(seed=5)
    assert (images == torch_images.numpy()).all()
    for name in METRICS:
        assert (infos[name] == np.asarray(torch_infos[name])).all(), name


def test_episodes_end_at_other_objects_on_tensors_too() -> None:
    config = small()
    arrays, tensors = ArmVectorEnv(config, 20), TorchArmVectorEnv(config, 20)
    arrays.reset(seed=5)
    tensors.reset(seed=5)
    agent = TryingAgent(arrays)
    agent.reset(Batch.of(arrays))
    wrong = 0
    for _ in range(SECOND_TRY):
        actions = agent.act({})
        _, _, terminated, _, infos = arrays.step(actions)
        _, _, torch_terminated, _, _ = tensors.step(torch.as_tensor(actions))
        assert (terminated == torch_terminated.numpy()).all()
        if terminated.any():
            wrong += (terminated & ~infos["final_info"]["is_success"]).sum()
    assert wrong


def test_an_episode_is_the_same_to_the_byte_at_any_number_of_environments() -> None:
    config = small(image_size=32, dynamics="dynamic", max_episode_steps=5)
    one, many = ArmVectorEnv(config, 1), ArmVectorEnv(config, 8, num_threads=2)
    one.reset(seed=12)
    many.reset(seed=5)
    generator = np.random.default_rng(0)
    for step in range(12):
        if step == 7:
            state = many.get_state()
        action = generator.integers(7, size=(1, 6))
        alone, together = one.step(action), many.step(np.repeat(action, 8, axis=0))
        for a, b in zip(alone[:4], together[:4], strict=True):
            assert a[0].tobytes() == b[-1].tobytes()
        for name in METRICS:
            assert alone[4][name][0].tobytes() == together[4][name][-1].tobytes(), name
    again = ArmVectorEnv(config, 8)
    again.set_state(state)
    assert {name: values.tobytes() for name, values in again.get_state().items()} == {
        name: values.tobytes() for name, values in state.items()
    }


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_checkers_pass_without_a_warning(robot: str) -> None:
    name = env_id(robot, "choose")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(name, render_mode="rgb_array")
        check_env(env.unwrapped)
        config = env.unwrapped.config  # type: ignore[attr-defined]
        rows = config.task.asked.knowledge_rows(setting_of(config).facets)
        shown = {"observe": ("image", "knowledge"), "knowledge": np.eye(len(rows))}
        env_checker.check_env(gymnasium.make(name, **shown).unwrapped)
    envs = gymnasium.make_vec(name, num_envs=2)
    assert envs.reset(seed=0)[1]["objects"].shape == (2, 4)


def test_marked_objects_show_the_answer() -> None:
    env = ArmVectorEnv(small(task=AskObject(marked=True)), 4)
    env.reset(seed=0)
    wanted = env.scene.geom_target == env.running.target[:, None]
    assert (env.running.shown.rgba[wanted] == [1, 0, 1, 1]).all()
    others = (
        (env.running.shown.rgba[..., 3] > 0) & (env.scene.geom_target >= 0) & ~wanted
    )
    assert (np.ptp(env.running.shown.rgba[others][:, :3], axis=1) == 0).all(), "grey"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": AskObject(objects=3), "targets": ("mug", "jar")}, "names 2"),
        ({"targets": ("mug",) * 4}, "twice"),
    ],
)
def test_configs_that_do_not_fit_are_refused(
    options: dict[str, Any], message: str
) -> None:
    with pytest.raises(UserError, match=message):
        small(**options)


@pytest.mark.parametrize(
    ("asked", "objects", "message"),
    [
        (AskObject, 0, "at least 1, got 0"),
        (AskObject, 7, "between 1 and 6, got 7"),
        (AskPart, 1, "between 2 and 6, got 1"),
    ],
)
def test_other_numbers_of_objects_are_refused(
    asked: type[AskObject], objects: int, message: str
) -> None:
    with pytest.raises(UserError, match=message):
        asked(objects=objects)


def test_a_single_object_answers_its_question() -> None:
    env = ArmVectorEnv(small(task=AskObject(objects=1)), 16)
    env.reset(seed=0)
    running = env.running
    table = questions_of(env.config)
    assert table is not None
    assert running.objects.shape == (16, 1)
    assert table.satisfies[running.question, running.facet].all()
    infos = env.config.task.infos(running)
    assert infos["is_right_object"].all()
    options: dict[str, Any] = {"episodes": 4, "probes": (), "write": False}
    result = knowarm.evaluate(OracleAgent, env.config, **options)
    assert result.summary["choice"] == 1
    assert "choice_corrected" not in result.summary.numbers
    assert "success_corrected" not in result.summary.numbers
    assert len(set(running.target)) > 1


def test_episodes_of_another_number_of_objects_are_refused() -> None:
    env = ArmVectorEnv(small(), 2)
    other = small(task=AskObject(objects=3))
    episodes = evaluation_episodes(other, 2, seed=0)
    with pytest.raises(UserError, match="hold 3 objects, and this environment has 4"):
        env.reset(options={"episodes": episodes})


def test_too_many_objects_for_the_rectangle_are_refused() -> None:
    large = ("pan", "watering_can", "teapot", "kettle", "basket", "toolbox")
    with pytest.raises(UserError, match="6 objects do not fit the rectangle"):
        arranged(small("tiago", targets=large, task=AskObject(objects=6)))
