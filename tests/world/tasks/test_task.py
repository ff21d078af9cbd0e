"""Tasks on two axes: names, combinations, refusals, and the end of episodes of solid objects."""

import numpy as np
import pytest

import knowarm
from knowarm.config import from_dict, to_dict
from knowarm.errors import UserError
from knowarm.experiment.names import ExperimentName, experiment_config
from knowarm.world.agents.protocol import Batch
from knowarm.world.config import EnvConfig
from knowarm.world.tasks import TASKS, find_task
from knowarm.world.tasks.asked.nothing import AskNothing
from knowarm.world.tasks.asked.part.part import AskPart
from knowarm.world.tasks.asked.query.query import AskObject
from knowarm.world.tasks.skills.lift.lift import Lift
from knowarm.world.tasks.skills.reach import Reach
from knowarm.world.tasks.task import Task


@pytest.mark.parametrize("name", [*TASKS, "families-lift"])
def test_a_name_says_both_parts(name):
    task = find_task(name)
    assert task.name == name
    config = EnvConfig(task=name)
    assert config.task == task
    assert from_dict(EnvConfig, to_dict(config)) == config
    assert set(to_dict(task)) == {"asked", "skill"}


def test_a_part_takes_the_place_of_its_kind():
    lifts = Task(asked=AskObject(objects=2), skill=Lift())
    assert find_task(Lift(), Task(asked=AskObject(objects=2))) == lifts
    assert find_task(AskNothing(), lifts) == Task(skill=Lift())
    assert find_task("reach", lifts) == Task()
    assert lifts.changes() == {"asked": {"objects": 2}, "skill": {}}


def test_objects_are_those_that_are_asked_for_and_can_be_lifted():
    targets = EnvConfig(task="choose-lift").targets
    assert set(targets) < set(AskObject.targets)
    assert "mug" in targets
    assert "bowl" not in targets
    assert EnvConfig(task="lift").targets == Lift.targets


def test_what_makes_no_sense_is_refused_in_one_line():
    with pytest.raises(
        UserError, match="Whole objects are lifted, and 'purpose' asks for parts"
    ):
        find_task("purpose-lift")
    with pytest.raises(UserError, match="A near start is for one object"):
        Task(asked=AskObject(), skill=Reach(start="near"))
    scara = "examples/own_robot/scara.toml"
    with pytest.raises(UserError, match="names no fingers"):
        knowarm.make(scara, num_envs=1, task=Lift(), targets=("bottle",))
    with pytest.raises(
        UserError, match=r"Unknown task 'choose-push'\. Did you mean 'choose"
    ):
        find_task("choose-push")
    assert AskPart().shares_places


def test_experiments_of_a_combination():
    name = ExperimentName.parse("irb120-choose-lift-answers-distil")
    assert (name.task, name.agent) == ("choose-lift", "answers")
    config = name.config()
    assert config.name == "irb120-choose-lift-answers-distil"
    assert (
        config.total_steps == experiment_config("irb120-lift-full-distil").total_steps
    )
    assert config.algorithm.way_limit == 2.0
    assert experiment_config("irb120-choose-lift-bm-a3c").env.task == find_task(
        "choose-lift"
    )
    assert (
        ExperimentName.parse("tiago-families-lift-answers-distil").task
        == "families-lift"
    )
    with pytest.raises(
        UserError, match="The agent 'mask' has no experiment of the task 'lift'"
    ):
        ExperimentName.parse("irb120-lift-mask-distil")


@pytest.fixture(scope="module")
def pick():
    task = Task(asked=AskObject(objects=2), skill=Lift())
    env = knowarm.make("tiago", num_envs=8, task=task, image_size=8)
    env.reset(seed=2)
    return env


def test_the_oracle_lifts_the_object_that_answers(pick):
    episodes = knowarm.evaluation_episodes(pick.config, 16, seed=0)
    result = knowarm.play(knowarm.OracleAgent(pick), pick, episodes)
    assert result.success.mean() >= 0.6
    assert (result.infos["rise"][result.success] >= 0.08).all()
    assert result.infos["is_right_object"][result.success].all()


def test_lifting_another_object_ends_the_episode(pick):
    pick.reset(seed=3)
    running = pick.running
    # What is asked changes places after the teacher has made its plan for the first object.
    agent = knowarm.OracleAgent(pick)
    agent.reset(Batch.of(pick))
    ended = np.zeros(8, dtype=np.bool_)
    lifted = np.zeros(8, dtype=np.bool_)
    task = pick.config.task
    for _ in range(100):
        pick.advance(agent.act({}), np.zeros(8, dtype=np.bool_))
        first = np.zeros(8, dtype=np.int64)
        now = task.skill.done_to(running, first)
        objects = running.objects
        running.objects = objects[:, ::-1].copy()
        running.positions = running.positions[:, ::-1].copy()
        assert (task.nearest(running)[now] == 1).all()
        failed = task.failure(running)
        running.objects = objects
        running.positions = running.positions[:, ::-1].copy()
        ended |= failed & now
        lifted |= now
    assert lifted.sum() >= 4
    assert (ended == lifted).all()
