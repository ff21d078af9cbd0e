"""Every number of every config has a range: extremes are refused in one line."""

import dataclasses
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, get_args

import pytest

from knowarm.cli.main import main
from knowarm.config import _READER, _hints, from_dict, to_dict
from knowarm.deploy.driver import Safety
from knowarm.errors import UserError
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.experiment.names import experiment_config
from knowarm.knowledge.kge import KgeConfig

EXPERIMENTS = [
    "full-fast",
    "full-ppo",
    "full-a3c",
    "full-distil",
    "choose-answers-fast",
]
CONFIGS = [
    *[experiment_config(f"irb120-{name}") for name in EXPERIMENTS],
    EvaluationConfig(),
    Safety(),
    KgeConfig(),
]
TOO_LARGE = [
    1e308,
    -1e308,
    10**29,
    -(10**29),
    10**400,
    1e20,
    float("inf"),
    float("nan"),
]
TOO_SMALL = [5e-324, 1e-300, -1e-300]


def has_number(hint: Any) -> bool:
    return hint in (int, float) or any(map(has_number, get_args(hint)))


def numbers(
    config: Any, path: tuple[str, ...] = ()
) -> Iterator[tuple[type, tuple[str, ...]]]:
    """Yield owner and path of all fields of a nested config that take a number."""
    hints = _hints(type(config))
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        here = (*path, field.name)
        if dataclasses.is_dataclass(value):
            yield from numbers(value, here)
        elif has_number(hints[field.name]) and _READER not in field.metadata:
            yield type(config), here


def changed(config: Any, path: tuple[str, ...], value: Any) -> Any:
    """Build a config again from its JSON values with one of them changed."""
    values = inner = to_dict(config)
    for name in path[:-1]:
        inner = inner[name]
    before = inner[path[-1]]
    inner[path[-1]] = [value] * len(before) if isinstance(before, list) else value
    return from_dict(type(config), values)


def cases() -> Iterator[tuple[Any, tuple[str, ...]]]:
    """Yield each field of each class of configs once, in the first config that has it."""
    seen = set()
    for config in CONFIGS:
        for owner, path in numbers(config):
            field = owner, path[-1]
            if field not in seen:
                seen.add(field)
                yield config, path


CASES = [*cases()]


def test_there_are_numbers():
    assert len(CASES) > 100
    assert {config.algorithm.name for config in CONFIGS[:5]} >= {"ppo", "a3c", "distil"}
    assert ALGORITHMS


@pytest.mark.parametrize(
    ("config", "path"),
    CASES,
    ids=lambda value: ".".join(value) if isinstance(value, tuple) else "",
)
def test_no_extreme_of_a_number_is_accepted(config, path):
    for value in TOO_LARGE + TOO_SMALL:
        if path[-1] == "seed" and value in (1e20, 10**29):
            continue
        with pytest.raises(UserError) as error:
            changed(config, path, value)
        assert "\n" not in str(error.value)
        assert len(str(error.value)) < 1000


@pytest.mark.parametrize(
    ("config", "path"),
    CASES,
    ids=lambda value: ".".join(value) if isinstance(value, tuple) else "",
)
def test_other_values_of_a_number_are_accepted_or_refused(config, path):
    for value in (0, 1, -1, 0.5, 3, 1e-9, 1e5, 10**5, True, "1", None, [], {}, "x" * 9):
        with suppress(UserError):
            again = changed(config, path, value)
            assert from_dict(type(again), to_dict(again)) == again


@pytest.mark.parametrize(
    ("config", "values"),
    [
        ("env", {"success_distance_m": 5.0}),
        ("env", {"mpi_rad": 1e4}),
        ("algorithm", {"num_envs": 10**7}),
        ("algorithm", {"ent_coef": 1e9}),
        ("algorithm", {"epochs": 10**6}),
    ],
)
def test_numbers_without_sense_are_refused(config, values):
    with pytest.raises(UserError, match=rf"{next(iter(values))} must be at most"):
        experiment_config("irb120-full-ppo", **{config: values})


@pytest.mark.parametrize(
    "words",
    [
        ["record", "oracle", "--to", "x", "--episodes", f"{10**29}"],
        ["doctor", "--robot", "irb120", "--distance-m", "5"],
        ["view", "oracle", "--episodes", f"{10**15}"],
        ["evaluate", "oracle", "--distance-m", "5"],
        ["ros", "zoo/irb120-full-fast", "--patience-s", "1e300"],
        ["ask", "zoo/irb120-choose-answers-fast", "a mug?", "--level", "1e99"],
    ],
    ids=" ".join,
)
def test_numbers_of_commands_have_a_range(words, capsys):
    assert main(words) == 2
    error = capsys.readouterr().err
    assert "must be at most" in error
    assert error.count("\n") == 1
