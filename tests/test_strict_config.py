import dataclasses
from typing import Literal

import pytest

from knowarm.config import from_dict, to_dict
from knowarm.errors import UserError
from knowarm.experiment.config import InterimConfig
from knowarm.experiment.names import experiment_config
from knowarm.knowledge import KnowledgeConfig
from knowarm.learn.algorithms import PPOConfig
from knowarm.world.config import EnvConfig
from knowarm.world.scene.appearance import VisualRandomization
from knowarm.world.tasks.asked.query.query import AskObject


@dataclasses.dataclass(frozen=True, kw_only=True)
class Slow:
    name: Literal["slow"] = "slow"
    workers: int = 17


@dataclasses.dataclass(frozen=True, kw_only=True)
class Fast:
    name: Literal["fast"] = "fast"
    rate: float = 1e-3


def test_a_mistyped_choice_is_refused_where_a_config_is_made():
    with pytest.raises(UserError, match=r"'Mean'.*Did you mean 'mean'"):
        KnowledgeConfig(detail="full", pooling="Mean")
    config = experiment_config("irb120-full-fast")
    with pytest.raises(UserError, match="'Full'"):
        dataclasses.replace(
            config, knows=dataclasses.replace(config.knows, detail="Full")
        )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: EnvConfig(max_episode_steps="many"),
            "max_episode_steps must be of type int",
        ),
        (
            lambda: EnvConfig(antialiasing="no"),
            "EnvConfig.antialiasing must be of type bool",
        ),
        (
            lambda: EnvConfig(targets=(3,)),
            r"EnvConfig.targets\[0\] must be of type str, got 3",
        ),
        (
            lambda: EnvConfig(task=AskObject),
            "must be a task, such as Task\\(\\), or its name",
        ),
        (lambda: EnvConfig(task="chose"), "Did you mean 'choose'"),
        (
            lambda: VisualRandomization(light="a"),
            "light must be between 0 and 1, got 'a'",
        ),
        (
            lambda: PPOConfig(learning_rate="a"),
            "PPOConfig.learning_rate must be of type float",
        ),
        (
            lambda: InterimConfig(every_steps="a"),
            "every_steps must be of type int, got 'a'",
        ),
    ],
)
def test_a_value_of_another_type_is_refused_where_a_config_is_made(make, message):
    with pytest.raises(UserError, match=message):
        make()


def test_a_config_of_an_environment_takes_its_task_by_name():
    assert EnvConfig(task="choose") == EnvConfig(task=AskObject())


@dataclasses.dataclass(frozen=True, kw_only=True)
class Whole:
    robot: str
    algorithm: Slow | Fast = dataclasses.field(default_factory=Slow)
    hidden: Literal["grow", "fixed"] | int = "grow"
    targets: tuple[str, ...] = ("mug",)
    limit: float | None = None


def test_what_was_written_is_read_back():
    whole = Whole(
        robot="irb120",
        algorithm=Fast(rate=0.5),
        hidden=64,
        targets=("a", "b"),
        limit=2.0,
    )
    assert from_dict(Whole, to_dict(whole)) == whole


def test_the_kind_of_an_alternative_is_read_from_its_name():
    assert (
        from_dict(Whole, {"robot": "x", "algorithm": {"name": "fast"}}).algorithm
        == Fast()
    )


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"robot": "x", "hiden": 3}, "Did you mean 'hidden'"),
        ({"robot": "x", "algorithm": {"name": "slow", "workres": 3}}, "'workers'"),
        ({"robot": "x", "algorithm": {"name": "medium"}}, "algorithm.name"),
        ({}, "'robot' is missing"),
        (
            {"robot": "x", "limit": 10**400},
            "limit must be below 1.8e308, got 1329 bits",
        ),
        ({"robot": 3}, "robot must be of type str, got 3"),
        ({"robot": "x", "targets": "mug"}, "targets must be a list"),
        ({"robot": "x", "hidden": "shrink"}, "hidden"),
        (
            {"robot": "x", "algorithm": {"name": "slow", "workers": True}},
            "workers must be of type int",
        ),
    ],
)
def test_errors_name_the_field_and_what_is_allowed(values, message):
    with pytest.raises(UserError) as caught:
        from_dict(Whole, values)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_whole_numbers_are_taken_for_floats():
    assert from_dict(Whole, {"robot": "x", "limit": 3}).limit == 3.0
