"""Checks of a robot's description: the example passes, and each defect is named with a remedy."""

from pathlib import Path

import pytest

from knowarm.world.config import EnvConfig
from knowarm.world.own_robot.robot_check import check_agents, check_robot
from tests.world.helpers import EXAMPLES, write_robot


def test_example_robot_passes_all_checks() -> None:
    checks = check_robot(EXAMPLES / "scara.toml", ["bottle", str(EXAMPLES / "bowl.toml")])
    assert [check for check in checks if not check.ok] == []
    assert {check.name for check in checks} >= {
        "joints",
        "gripper",
        "servos",
        "reach of bowl",
        "green bowl in the image",
    }


@pytest.mark.parametrize(
    ("changes", "name", "words"),
    [
        ({"rectangle_centre_m": "[0.75, 0.0]"}, "reach of bottle", "move or shrink the rectangle"),
        ({"camera_fovy_deg": "150.0"}, "yellow bottle in the image", "camera_fovy_deg"),
        ({"tcp_quaternion": "[1.0, 0.0, 0.0, 0.0]"}, "gripper", "tcp_quaternion"),
        ({"servo_frequency_hz": "0.5"}, "servos", "servo_frequency_hz"),
        ({"rectangle_half_size_m": "[0.001, 0.001]"}, "without looking", "enlarge the rectangle"),
        ({"joints": '["shoulder", "knee"]'}, "scene", "home has"),
    ],
)
def test_defects_are_named_with_a_remedy(
    changes: dict, name: str, words: str, tmp_path: Path
) -> None:
    bad = {check.name: check for check in check_robot(write_robot(tmp_path, **changes), ["bottle"])}
    assert not bad[name].ok
    assert words in bad[name].remedy + bad[name].found


def test_a_way_that_takes_most_of_an_episode_is_named() -> None:
    robot = str(EXAMPLES / "scara.toml")
    config = EnvConfig(robot=robot, targets=("bottle",), mpi_rad=0.015, image_size=1)
    way = next(check_agents(config))
    assert not way.ok
    assert "home or mpi_rad" in way.remedy
