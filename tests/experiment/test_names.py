"""Names of experiments are written and read by one class."""

import shutil
from pathlib import Path

import pytest

from knowarm.cli.train import Train
from knowarm.config import override
from knowarm.errors import UserError
from knowarm.experiment.names import ExperimentName, experiment_config, experiment_names
from knowarm.study.config import StudyConfig
from knowarm.world.robots import DEFAULT_ROBOT, ROBOTS
from knowarm.world.tasks import task_names
from tests.thorough import share


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("irb120-full-dr-fast", ("irb120", "reach", "full", "randomized", "fast")),
        (
            "irb120-choose-subgraph-fast",
            ("irb120", "choose", "subgraph", "randomized", "fast"),
        ),
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
    assert (config.env.robot, config.env.task.name, config.agent) == parts[:3]
    assert (config.env.colours, config.learner) == parts[3:]


def test_every_name_is_read_as_it_is_written():
    names = experiment_names()
    assert len(set(names)) == len(names)
    # The number of names is no multiple of 7: robots, agents and algorithms take turns.
    read = {name: ExperimentName.parse(name) for name in share(names, 0, 7)}
    assert all(str(parsed) == name for name, parsed in read.items())
    tasks = {parsed.task for parsed in read.values()}
    assert tasks == set(task_names())


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "irb120",
            r"ROBOT-TASK-AGENT-ALGORITHM.*got 'irb120'.*such as 'irb120-full-fast'",
        ),
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
def test_the_robot_is_an_option_and_every_robot_has_names_of_its_own(
    name, robot, written, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROBOTS[DEFAULT_ROBOT].mjcf.parent, "arms")
    Path("arms", f"{DEFAULT_ROBOT}.toml").rename("arms/my_arm.toml")
    env = {} if robot is None else {"robot": robot}
    config = experiment_config(name, env=env)
    assert config.name == written
    assert config.env.robot == (robot or written.partition("-")[0])
    assert experiment_config(name, env=env, name="mine").name == "mine"
    others = written.partition("-")[2]
    by_default = experiment_config(f"{DEFAULT_ROBOT}-{others}")
    same = {"name": by_default.name, "env": {"robot": DEFAULT_ROBOT}}
    assert override(config, same) == by_default


@pytest.fixture
def kitchen(tmp_path):
    path = tmp_path / "kitchen.csv"
    path.write_text("head,relation,tail\nmug,usedFor,drinking\n")
    return str(path)


def graphs_of(config):
    return config.knows.graph, config.env.task.asked.queries.graph


def test_one_graph_is_that_of_the_questions_and_the_knowledge(kitchen):
    name = "irb120-choose-subgraph-fast"
    assert graphs_of(experiment_config(name, graph=kitchen)) == (kitchen, kitchen)
    assert experiment_config("irb120-full-fast", graph=kitchen).knows.graph == kitchen
    control = experiment_config("irb120-choose-bm-fast", graph=kitchen)
    assert control.env.task.asked.queries.graph == kitchen
    with pytest.raises(UserError, match="does not concern irb120-bm-fast"):
        experiment_config("irb120-bm-fast", graph=kitchen)
    words = [name, "--graph", kitchen]
    assert graphs_of(Train.parse("", words).config) == (kitchen, kitchen)


def test_two_graphs_are_taken_only_if_both_are_named(kitchen):
    name = "irb120-choose-subgraph-fast"
    knows, asks = (
        {"knows": {"graph": kitchen}},
        {"env": {"task": {"asked": {"queries": {"graph": kitchen}}}}},
    )
    for one in (knows, asks):
        with pytest.raises(UserError, match=r"For both pass graph='.*kitchen\.csv'"):
            experiment_config(name, **one)
        with pytest.raises(UserError, match="For both pass graph"):
            StudyConfig(name="s", experiments=(name,), seeds=(0,), overrides=one)
    for flag in ("--knows.graph", "--env.task.asked.queries.graph"):
        with pytest.raises(UserError, match="For both pass graph"):
            Train.parse("", [name, flag, kitchen])
    other = {"env": {"task": {"asked": {"queries": {"graph": "household"}}}}}
    assert graphs_of(experiment_config(name, **knows, **other)) == (
        kitchen,
        "household",
    )
    words = [
        name,
        "--knows.graph",
        kitchen,
        "--env.task.asked.queries.graph",
        "household",
    ]
    assert graphs_of(Train.parse("", words).config) == (kitchen, "household")
    words = [name, "--graph", "household", "--knows.graph", kitchen]
    assert graphs_of(Train.parse("", words).config) == (kitchen, "household")
