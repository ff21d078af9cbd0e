"""Purpose task: grasp frames of parts, questions about one part, and what counts as a mistake."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.experiment.names import experiment_config
from knowarm.knowledge.formats import shipped_graph
from knowarm.questions import find_rows, number_parts, object_of
from knowarm.world.agents.play import play
from knowarm.world.agents.protocol import Batch
from knowarm.world.agents.scripted import OracleAgent
from knowarm.world.config import EnvConfig, questions_of, scene_of
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.objects import PARTS, TARGETS
from knowarm.world.robots import ROBOTS
from knowarm.world.scene.appearance import MARKED_RGB
from knowarm.world.scene.scene import Scene, build_scene
from knowarm.world.tasks.asked.part.part import AskPart
from knowarm.world.tasks.asked.query.query import CHOOSE_TARGETS
from knowarm.world.tasks.sampling import Episodes
from tests.world.tasks.asked.test_query import PickingAgent

FEW = tuple(name for name in PARTS if object_of(name) in ("bottle", "brush", "globe"))
PAPER = 0.10, 17.0
"""The widest thresholds of an evaluation [m], [deg]."""
TIP_M = 0.02
"""Length of the IRB120's fingers beyond the tool centre point [m]."""
OPENING_M = 0.064
"""Distance of the IRB120's fingers from each other [m]."""


def small(**options: Any) -> EnvConfig:
    defaults = {
        "task": AskPart(),
        "targets": FEW,
        "image_size": 8,
        "dynamics": "kinematic",
    }
    return EnvConfig(**(defaults | options))


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Return the parts of the task, for the IRB120."""
    return scene_of(EnvConfig(task=AskPart()))


@pytest.fixture(scope="module")
def drawn() -> tuple[ArmVectorEnv, Episodes]:
    env = ArmVectorEnv(small(), 16)
    return env, evaluation_episodes(env.config, 16, 3)


def widths(scene: Scene, k: int) -> float:
    """Measure a target alone, along the finger opening, from its grasp point to the tips [m]."""
    model = scene.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    site = model.site(f"{scene.targets[k].name}/{scene.targets[k].grasp_site}").id
    point, (_, across, ahead) = (
        data.site_xpos[site],
        data.site_xmat[site].reshape(3, 3).T,
    )
    least = 0.3
    for depth in np.linspace(0, TIP_M, 9):
        for side in (across, -across):
            start = point + depth * ahead + 0.3 * side
            hits = [
                mujoco.mju_rayGeom(
                    *(
                        data.geom_xpos[g],
                        data.geom_xmat[g],
                        model.geom_size[g],
                        start,
                        -side,
                    ),
                    int(model.geom_type[g]),
                )
                for g in np.flatnonzero(scene.geom_target == k)
            ]
            least = min([least, *(hit for hit in hits if hit >= 0)])
    return 2 * (0.3 - least)


def test_every_part_fits_between_the_fingers():
    robot = ROBOTS["irb120"].for_area("purpose")
    for name, target in PARTS.items():
        assert 0.01 < widths(build_scene(robot, [target]), 0) < OPENING_M, name


def test_no_pose_grasps_two_parts_of_an_object(scene):
    for a, one in enumerate(scene.targets):
        for b, other in enumerate(scene.targets[:a]):
            if object_of(one.name) == object_of(other.name):
                turn = scene.grasp_matrix[a].T @ scene.grasp_matrix[b]
                angle = np.degrees(np.arccos((np.trace(turn) - 1) / 2))
                way = np.linalg.norm(scene.grasp_position[a] - scene.grasp_position[b])
                assert angle > 2 * PAPER[1] or way > 2 * PAPER[0], (
                    one.name,
                    other.name,
                )


def test_parts_draw_their_object_once(scene):
    names = [
        scene.model.geom(g).name.split("/")
        for g in np.flatnonzero(scene.geom_target >= 0)
    ]
    for whole in {object_of(name) for name in PARTS}:
        alone = build_scene(scene.robot, [TARGETS[whole]])
        geoms = [
            alone.model.geom(g).name for g in np.flatnonzero(alone.geom_target >= 0)
        ]
        drawn = {part: name for name, part in names if object_of(name) == whole}
        assert sorted(drawn) == sorted(name.split("/")[1] for name in geoms)
        for part in (name for name in PARTS if object_of(name) == whole):
            own = PARTS[part].part_geoms
            assert own
            assert all(drawn[geom] == part for geom in own)


def test_the_graph_knows_every_part():
    graph = shipped_graph("purposes")
    assert set(PARTS) == set(AskPart.targets)
    facts = {head for head, relation, _ in graph if relation == "graspedFor"}
    assert set(PARTS) <= facts
    assert {object_of(name) for name in facts} >= set(CHOOSE_TARGETS)


def test_one_part_answers_and_both_parts_stand_at_one_place(drawn):
    env, episodes = drawn
    names = np.array([object_of(name) for name in FEW])[episodes.objects]
    assert (np.sort(names, axis=1)[:, ::2] == np.sort(names, axis=1)[:, 1::2]).all()
    assert all(len(set(row)) == 2 for row in names.tolist())
    same = names[:, :, None] == names[:, None]
    places = episodes.positions[:, :, None] == episodes.positions[:, None]
    assert (places.all(axis=3) == same).all()
    table = questions_of(env.config)
    facets = [
        env.facets.index((FEW[o], env.scene.colour_names[o][c]))
        for o, c in zip(episodes.objects.ravel(), episodes.colours.ravel(), strict=True)
    ]
    rows = {query.name: row for row, query in enumerate(table.queries)}
    asked = find_rows("query", episodes.question, rows)
    answers = table.satisfies[asked[:, None], np.reshape(facets, (-1, 4))]
    assert (answers == [True, False, False, False]).all()


def test_the_other_part_of_the_right_object_is_a_mistake(drawn):
    env, episodes = drawn

    class OtherPart(PickingAgent):
        """Moves to the other part of the right object."""

        def reset(self, batch: Batch) -> None:
            OracleAgent.reset(self, batch)
            places = self._env.running.positions
            beside = (places[:, 1:] == places[:, :1]).all(axis=2)
            self._go_to(1 + beside.argmax(axis=1))

    right, wrong = (
        play(OracleAgent(env), env, episodes),
        play(OtherPart(env), env, episodes),
    )
    assert right.success.mean() > 0.95
    assert right.infos["is_right_object"].mean() > 0.95
    assert not wrong.success.any()
    assert (wrong.length < env.config.max_episode_steps).mean() > 0.95
    columns = env.config.task.columns(env.running.setting, wrong.infos)
    assert columns["object_correct"].mean() > 0.95
    assert columns["choice_correct"].mean() < 0.05
    assert set(columns["chosen"]) <= set(FEW)


def test_the_upper_bound_marks_the_part_alone():
    config = small(task=AskPart(marked=True), image_size=64)
    env = ArmVectorEnv(config, 8)
    env.reset(seed=0)
    painted = (env.running.shown.rgba[..., :3] == np.float32(MARKED_RGB)).all(axis=2)
    shown = painted & (env.running.shown.rgba[..., 3] > 0)
    for row, goal in zip(shown, env.running.target, strict=True):
        assert set(env.scene.geom_target[row]) == {goal}
        assert {
            env.scene.model.geom(g).name.split("/")[1] for g in np.flatnonzero(row)
        } >= set(PARTS[FEW[goal]].part_geoms)


def test_objects_need_the_same_number_of_parts():
    with pytest.raises(UserError, match="2 of bottle, 1 of brush"):
        number_parts(
            (("bottle.neck", "red"), ("bottle.stopper", "red"), ("brush.block", "red"))
        )


def test_a_task_with_one_object_has_one_part_of_each():
    one = EnvConfig(targets=("bottle.neck", "brush"))
    assert evaluation_episodes(one, 8, 0).objects.max() == 1
    with pytest.raises(UserError, match="several parts of one object"):
        evaluation_episodes(
            replace(one, targets=("bottle.neck", "bottle.stopper")), 8, 0
        )


@pytest.mark.parametrize("split", ["S2", "S4", "S5"])
def test_every_split_asks_about_parts(split):
    env = experiment_config("irb120-purpose-bm-fast").env
    trained, tested = (
        questions_of(replace(env, task=env.task.asking(split=each)))
        for each in ("train", split)
    )
    asked = {
        (q, object_of(trained.facets[f][0]))
        for q, f in np.argwhere(tested.askable).tolist()
    }
    assert asked
    others = tested.satisfies[:, tested.parts].sum(axis=2)
    assert (others[tested.askable] == 1).all()
    if split == "S2":
        assert not (tested.askable & trained.askable).any()
