"""A task from a module outside the package: the example ``hover``."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from knowarm.config import from_dict, to_dict
from knowarm.errors import UserError
from knowarm.world.agents.play import play
from knowarm.world.agents.protocol import Batch
from knowarm.world.agents.scripted import OracleAgent
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks import VARIABLE, register_task, task_names
from knowarm.world.tasks.skills import SKILLS
from knowarm.world.tasks.skills.reach import Reach
from knowarm.world.tasks.skills.skill import Skill

FOLDER = Path(__file__).parents[3] / "examples" / "own_task"


class Untagged(Skill):
    """Has no field ``kind`` with a literal."""


class Twice(Reach):
    """Has the kind of another task."""


@pytest.fixture
def hover(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setitem(SKILLS, "hover", "hover:Hover")
    reach = "knowarm.world.tasks.skills.reach:Reach"
    monkeypatch.setenv(VARIABLE, reach)
    found = register_task("hover:Hover")
    # Child processes know it, too
    assert os.environ[VARIABLE] == f"{reach},hover:Hover"
    monkeypatch.setenv(VARIABLE, "")
    yield found
    sys.modules.pop("hover", None)


def test_the_oracle_holds_the_gripper_above_the_object(hover: Any) -> None:
    config = EnvConfig(task=hover(), image_size=8, dynamics="kinematic")
    env = ArmVectorEnv(config, 30)
    result = play(OracleAgent(env), env, evaluation_episodes(config, 30, 0))
    assert result.success.mean() >= 0.95
    assert (result.infos["held"][result.success] == 10).all()
    held = result.steps.distance < 0.05
    assert (np.bincount(result.steps.episode, held)[result.success] >= 10).all()


def test_the_goal_is_above_the_grasp(hover: Any) -> None:
    plain, above = EnvConfig(image_size=8), EnvConfig(task=hover(), image_size=8)
    envs = [ArmVectorEnv(config, 4) for config in (plain, above)]
    for env in envs:
        env.reset(seed=1)
    assert envs[1].running.goal_position - envs[
        0
    ].running.goal_position == pytest.approx(np.tile([0, 0, 0.1], (4, 1)))


def test_what_a_task_remembers_is_part_of_the_state(hover: Any) -> None:
    config = EnvConfig(task=hover(), image_size=8, dynamics="kinematic")
    env = ArmVectorEnv(config, 3)
    agent = OracleAgent(env)
    env.reset(seed=1)
    agent.reset(Batch.of(env))
    for _ in range(50):
        _, _, _, _, infos = env.step(agent.act({}))
        if infos["held"].max() > 3:
            break
    state, held = env.get_state(), infos["held"]
    other = ArmVectorEnv(config, 3)
    other.set_state(state)
    assert (other.running.memory["held"] == held).all()
    still = np.zeros((3, 6), dtype=np.int64)
    assert (env.step(still)[4]["held"] == other.step(still)[4]["held"]).all()


def test_it_is_stored_and_read_by_its_tag(hover: Any) -> None:
    config = EnvConfig(task=hover(height_m=0.2))
    assert from_dict(EnvConfig, to_dict(config)) == config


def test_a_task_that_is_not_registered_is_named() -> None:
    values = to_dict(EnvConfig()) | {"task": {"skill": {"kind": "hover"}}}
    with pytest.raises(UserError, match="hover"):
        from_dict(EnvConfig, values)
    assert "hover" not in task_names()


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("no_such_module:Hover", "Cannot import the task 'no_such_module:Hover'"),
        ("knowarm.world.tasks.skills.reach:Reech", "has no 'Reech'"),
        ("knowarm.world.config:EnvConfig", "is no task"),
        (":Hover", "is given as package.module:Name, got ':Hover'"),
        (".reach:Reach", "is given as package.module:Name"),
        ("tests.world.tasks.test_own_task:Untagged", "needs a field that names it"),
        ("tests.world.tasks.test_own_task:Twice", "has the kind 'reach', which"),
    ],
)
def test_what_is_no_task_is_refused_in_one_line(place: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        register_task(place)
