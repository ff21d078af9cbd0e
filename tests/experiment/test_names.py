"""Names of experiments are written and read by one class."""

import pytest

from knowarm.config import override
from knowarm.errors import UserError
from knowarm.experiment.names import ExperimentName, experiment_config, experiment_names
from knowarm.world.robots import DEFAULT_ROBOT
from knowarm.world.tasks import task_names


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("irb120-full-dr-fast", ("irb120", "reach", "full", "randomized", "fast")),
        ("irb120-choose-subgraph-fast", ("irb120", "choose", "subgraph", "randomized", "fast")),
        (
            "tiago-target-random+-a3c-tuned",
            ("tiago", "reach", "target-random+", "fixed", "a3c-tuned"),
        ),
    ],
)
def test_a_name_has_five_parts(text, parts):
    name = ExperimentName.parse(text)
    assert name == ExperimentName(*parts)
    assert str(name) == text
    config = experiment_config(text)
    assert (config.env.robot, config.env.task.kind, config.agent) == parts[:3]
    assert (config.env.colours, config.learner) == parts[3:]


def test_every_name_is_read_as_it_is_written():
    names = experiment_names()
    assert len(set(names)) == len(names)
    assert all(str(ExperimentName.parse(name)) == name for name in names)
    assert {ExperimentName.parse(name).task for name in names} == set(task_names())


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("irb120", r"ROBOT-TASK-AGENT-ALGORITHM.*got 'irb120'.*such as 'irb120-full-fast'"),
        ("full", "such as 'irb120-full-fast'"),
        ("subgraph", "such as 'irb120-choose-subgraph-fast'"),
        ("tiago-bm", "such as 'tiago-bm-fast'"),
        ("irb120-choose-full-fast", "'full' has no experiment of the task 'choose'"),
        ("irb120-choose-bm-dr-fast", "is named 'irb120-choose-bm-fast'"),
        ("irb12-full-ppo", "Did you mean 'irb120'"),
        ("pand-full-ppo", "Did you mean 'panda'"),
        ("ful-ppo", "Did you mean 'full'"),
        ("irb120-ful-ppo", "Did you mean 'full'"),
        ("irb120-full-pp", "Did you mean 'ppo'"),
    ],
)
def test_unknown_names_offer_the_nearest(name, message):
    with pytest.raises(UserError, match=message):
        experiment_config(name)


@pytest.mark.parametrize(
    ("name", "robot", "written"),
    [
        ("full-distil", None, f"{DEFAULT_ROBOT}-full-distil"),
        ("choose-answers-fast", "tiago", "tiago-choose-answers-fast"),
        ("panda-full-dr-distil", None, "panda-full-dr-distil"),
        ("full-distil", "arms/my_arm.toml", "my_arm-full-distil"),
        ("irb120-full-distil", "panda", "panda-full-distil"),
    ],
)
def test_the_robot_is_an_option_and_every_robot_has_names_of_its_own(name, robot, written):
    env = {} if robot is None else {"robot": robot}
    config = experiment_config(name, env=env)
    assert config.name == written
    assert config.env.robot == (robot or written.partition("-")[0])
    assert experiment_config(name, env=env, name="mine").name == "mine"
    others = written.partition("-")[2]
    by_default = experiment_config(f"{DEFAULT_ROBOT}-{others}")
    same = {"name": by_default.name, "env": {"robot": DEFAULT_ROBOT}}
    assert override(config, same) == by_default
