from pathlib import Path

import numpy as np
import pytest
from conftest import MakeEnv

from knowarm.errors import UserError
from knowarm.world.agents.scripted import OracleAgent
from knowarm.world.description_file import read_robot, read_target
from knowarm.world.doctor import check_robot
from knowarm.world.episodes import evaluation_episodes
from knowarm.world.play import play
from knowarm.world.robots import ROBOTS

EXAMPLES = Path(__file__).parents[2] / "examples" / "own_robot"


def test_the_recipe_s_robot_of_primitives_and_fourth_target_can_be_solved(
    make_env: MakeEnv,
) -> None:
    env = make_env(
        60,
        robot=str(EXAMPLES / "scara.toml"),
        targets=("bottle", str(EXAMPLES / "bowl.toml")),
        colours="randomized",
    )
    assert env.facets[2:] == (("bowl", "green"), ("bowl", "orange"))
    episodes = evaluation_episodes(env.scene, env.config, 60, seed=1)
    assert set(episodes.target) == {0, 1}
    assert play(OracleAgent(), env, episodes).success.mean() >= 0.97


def test_the_doctor_finds_nothing_to_mend_on_the_recipe_s_robot() -> None:
    checks = check_robot(EXAMPLES / "scara.toml", ["bottle", str(EXAMPLES / "bowl.toml")])
    assert [check for check in checks if not check.ok] == []
    assert {check.name for check in checks} >= {
        "joints",
        "gripper",
        "servos",
        "reach of bowl",
        "green bowl in the image",
    }


def written(path: Path, **changes: str) -> Path:
    """The recipe's file with fields changed; an empty value takes the field out."""
    lines = [f"{name} = {value}" for name, value in changes.items() if value]
    for line in (EXAMPLES / "scara.toml").read_text().splitlines():
        name = line.partition("=")[0].strip()
        if name == "mjcf" and "mjcf" not in changes:
            line = f'mjcf = "{EXAMPLES / "scara.xml"}"'
        if name not in changes:
            lines.append(line)
    out = path / "robot.toml"
    out.write_text("\n".join(lines))
    return out


@pytest.mark.parametrize(
    ("changes", "name", "words"),
    [
        ({"rectangle_centre_m": "[0.75, 0.0]"}, "reach of bottle", "move or shrink the rectangle"),
        ({"camera_fovy_deg": "150.0"}, "yellow bottle in the image", "camera_fovy_deg"),
        ({"tcp_quaternion": "[1.0, 0.0, 0.0, 0.0]"}, "gripper", "tcp_quaternion"),
        ({"servo_frequency_hz": "0.5"}, "servos", "servo_frequency_hz"),
        ({"joints": '["shoulder", "knee"]'}, "scene", "home has"),
    ],
)
def test_the_doctor_says_what_to_mend(changes: dict, name: str, words: str, tmp_path: Path) -> None:
    bad = {check.name: check for check in check_robot(written(tmp_path, **changes), ["bottle"])}
    assert not bad[name].ok
    assert words in bad[name].remedy + bad[name].found


def test_the_doctor_tells_what_a_bare_mjcf_still_needs() -> None:
    checks = {check.name: check for check in check_robot(ROBOTS["irb120"].robot.mjcf)}
    assert "joint_6" in checks["joints"].found
    assert not checks["description"].ok
    assert 'joints = ["joint_1", ' in checks["description"].remedy


def test_bad_files_are_named_with_the_field(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"Cannot read .*none.toml"):
        read_robot(tmp_path / "none.toml")
    path = tmp_path / "bad.toml"
    path.write_text("mjcf = [")
    with pytest.raises(UserError, match=r"bad.toml' is not TOML"):
        read_robot(path)
    path.write_text("name = 'x'")
    with pytest.raises(UserError, match="field mjcf must be the path"):
        read_target(path)
    with pytest.raises(UserError, match=r"Did you mean 'joints'"):
        read_robot(written(tmp_path, home='[0.0, 0.0, 0.0, 0.0]\njoint = ["a"]'))
    with pytest.raises(UserError, match="package 'no_such_package' is not installed"):
        read_robot(written(tmp_path, mjcf='"no_such_package:a.xml"'))
    with pytest.raises(UserError, match="camera_fovy_deg"):
        read_robot(written(tmp_path, camera_fovy_deg=""))


def test_an_arm_with_meshes_from_a_package_can_be_solved(make_env: MakeEnv) -> None:
    pytest.importorskip("dm_control")
    env = make_env(40, robot=str(EXAMPLES / "jaco.toml"), targets=("bottle",))
    assert np.isin(7, env.scene.model.geom_type), "it has meshes"
    episodes = evaluation_episodes(env.scene, env.config, 40, seed=1)
    assert play(OracleAgent(), env, episodes).success.mean() >= 0.97
