"""A task from a module outside the package: the example ``hover``."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import knowarm
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


def bad_methods() -> list[Any]:
    """List what own methods may return wrongly, and what the error says of it."""
    three = r"shape \(3,\), got"
    columns = np.ones((3, 1))
    frames = (np.zeros((3, 2)), np.zeros((3, 9)))
    return [
        ("skill", "reward", 1.0, rf"numbers of {three} float64 of shape \(\)"),
        ("skill", "reward", [1.0, 2.0], rf"{three} float64 of shape \(2,\)"),
        ("skill", "reward", columns, rf"{three} float64 of shape \(3, 1\)"),
        ("skill", "reward", ["a", "b", "c"], rf"numbers of {three} <U1"),
        ("skill", "success", False, rf"bool of {three} bool of shape \(\)"),
        ("skill", "success", [0.0, 1.0, 0.0], rf"bool of {three} float64 of shape \(3"),
        ("skill", "failure", True, rf"bool of {three}"),
        ("skill", "done_to", True, rf"bool of {three}"),
        ("skill", "infos", {"far": 1.0}, rf"{three}|\(3,\)"),
        ("skill", "memory", {"seen": np.zeros(2)}, rf"{three} float64 of shape \(2,\)"),
        ("skill", "goal_frames", frames, r"numbers of shape \(3, 3\), got .*\(3, 2\)"),
        ("asked", "infos", {"near": np.zeros(4)}, rf"{three} float64 of shape \(4,\)"),
        ("asked", "nearest", 0, rf"numbers of {three}"),
        ("asked", "knowledge_input", 0, rf"numbers of {three}"),
    ]


@pytest.mark.parametrize(("part", "method", "value", "message"), bad_methods())
def test_a_method_that_returns_another_shape_is_named_in_one_line(
    part: str, method: str, value: Any, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def wrong(self: Any, *_: Any) -> Any:
        return value

    wrong.__name__ = method
    env = EnvConfig(task=knowarm.AskObject(), image_size=8)
    owner = type(getattr(env.task, part))
    monkeypatch.setattr(owner, method, wrong)

    def step() -> None:
        made = ArmVectorEnv(env, 3)
        assert len(made.knowledge_input) == 3
        made.reset(seed=0)
        made.step(np.zeros((3, 6), int))

    with pytest.raises(UserError, match=message) as error:
        step()
    assert str(error.value).startswith(f"{owner.__name__}.{method} must return ")
    assert "\n" not in str(error.value)
