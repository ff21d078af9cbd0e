"""Numbers that are none, and seeds that no generator takes, are refused wherever they are given."""

import dataclasses

import pytest

from knowarm.cli.main import main
from knowarm.errors import UserError
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.experiment.names import experiment_config
from knowarm.learn.algorithms import A3CConfig, PPOConfig
from knowarm.world.config import EnvConfig
from knowarm.world.description import read_description
from knowarm.world.robots import DEFAULT_ROBOT, ROBOTS
from knowarm.world.robots.robot import Robot

NOT_FINITE = [float("nan"), float("inf"), float("-inf")]


@pytest.mark.parametrize("value", NOT_FINITE)
@pytest.mark.parametrize(
    ("config", "field"),
    [
        (EnvConfig, "mpi_rad"),
        (EnvConfig, "success_angle_deg"),
        (EvaluationConfig, "distance_m"),
        (PPOConfig, "learning_rate"),
        (A3CConfig, "reward_scale"),
    ],
)
def test_configs_refuse_numbers_that_are_not_finite(config, field, value):
    with pytest.raises(UserError, match=f"{field}"):
        config(**{field: value})


@pytest.mark.parametrize("seed", [-1, 2**63, 2**70])
def test_seeds_have_63_bits(seed):
    config = experiment_config("irb120-full-ppo")
    for given in (config, EvaluationConfig()):
        with pytest.raises(UserError, match="seed must"):
            dataclasses.replace(given, seed=seed)
    assert dataclasses.replace(config, seed=2**63 - 1).seed == 2**63 - 1


@pytest.mark.parametrize("value", NOT_FINITE)
@pytest.mark.parametrize("field", ["base_position_m", "held_joints", "camera_fovy_deg"])
def test_robots_refuse_numbers_that_are_not_finite(field, value):
    changed = {
        "base_position_m": (0.0, value, 0.0),
        "held_joints": {"finger": value},
        "camera_fovy_deg": value,
    }
    with pytest.raises(UserError, match=field):
        dataclasses.replace(ROBOTS[DEFAULT_ROBOT], **{field: changed[field]})


def test_a_robot_file_with_an_over_long_path_or_a_number_that_is_none(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(f'mjcf = "{"a" * 5000}"\n')
    with pytest.raises(UserError):
        read_description(path, Robot)
    path.write_text('mjcf = "a.xml"\nbase_position_m = [nan, 0.0, 0.0]\n')
    with pytest.raises(UserError):
        read_description(path, Robot)


@pytest.mark.parametrize(
    "option", ["--env.mpi-rad", "--algorithm.gamma", "--algorithm.clip-range"]
)
def test_the_command_line_refuses_infinity(capsys, option):
    assert main(["train", "irb120-bm-ppo", option, "inf"]) == 2
    assert "finite" in " ".join(capsys.readouterr().err.split())
