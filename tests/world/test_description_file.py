"""Description files: own robots and targets are read, solved, and refused by field."""

import os
from pathlib import Path

import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.world.agents.play import play
from knowarm.world.agents.scripted import OracleAgent
from knowarm.world.description import read_description
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.objects.target import Target
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.scene import load_scene
from tests.world.helpers import EXAMPLES, MakeEnv, write_robot


def test_example_robot_and_target_can_be_solved(
    make_env: MakeEnv,
) -> None:
    env = make_env(
        60,
        robot=str(EXAMPLES / "scara.toml"),
        targets=("bottle", str(EXAMPLES / "bowl.toml")),
        colours="randomized",
    )
    assert env.facets[2:] == (("bowl", "green"), ("bowl", "orange"))
    episodes = evaluation_episodes(env.config, 60, seed=1)
    assert set(episodes.target) == {0, 1}
    assert play(OracleAgent(env), env, episodes).success.mean() >= 0.97


def test_name_and_title_default_to_the_file_and_the_name(tmp_path: Path) -> None:
    robot = read_description(EXAMPLES / "scara.toml", Robot)
    assert (robot.name, robot.title) == ("scara", "scara")
    assert (
        read_description(write_robot(tmp_path, title='"Scara 2"'), Robot).title
        == "Scara 2"
    )


def test_an_edited_description_is_read_again(tmp_path: Path) -> None:
    path = write_robot(tmp_path, camera_fovy_deg="40")
    first = load_scene(str(path), ("bottle",))
    assert load_scene(str(path), ("bottle",)) is first
    write_robot(tmp_path, camera_fovy_deg="55")
    os.utime(path, ns=(0, 0))  # another time than before, however fast the disk
    assert load_scene(str(path), ("bottle",)).robot.camera_fovy_deg == 55


def test_bad_files_are_named_with_the_field(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"Cannot read .*none.toml"):
        read_description(tmp_path / "none.toml", Robot)
    path = tmp_path / "bad.toml"
    path.write_text("mjcf = [")
    with pytest.raises(UserError, match=r"bad.toml' is not TOML"):
        read_description(path, Robot)
    path.write_text("name = 'x'")
    with pytest.raises(UserError, match="field mjcf must be the path"):
        read_description(path, Target)
    with pytest.raises(UserError, match=r"Did you mean 'joints'"):
        read_description(
            write_robot(tmp_path, home='[0.0, 0.0, 0.0, 0.0]\njoint = ["a"]'), Robot
        )
    with pytest.raises(UserError, match="package 'no_such_package' is not installed"):
        read_description(write_robot(tmp_path, mjcf='"no_such_package:a.xml"'), Robot)
    with pytest.raises(UserError, match="camera_fovy_deg"):
        read_description(write_robot(tmp_path, camera_fovy_deg=""), Robot)
    drive = read_description(write_robot(tmp_path, mjcf="'C:/arms/a.xml'"), Robot)
    # A path, not a Python package C
    assert drive.mjcf.as_posix().endswith("C:/arms/a.xml")
    (tmp_path / "a.urdf").touch()
    with pytest.raises(UserError, match="Convert it: knowarm doctor --robot"):
        load_scene(str(write_robot(tmp_path, mjcf='"a.urdf"')), ("bottle",))
    with pytest.raises(UserError, match=r"is a model file\. Draft a description"):
        load_scene(str(tmp_path / "a.urdf"), ("bottle",))


def test_an_arm_with_meshes_from_a_package_can_be_solved(make_env: MakeEnv) -> None:
    pytest.importorskip("dm_control")
    env = make_env(40, robot=str(EXAMPLES / "jaco.toml"), targets=("bottle",))
    assert np.isin(7, env.scene.model.geom_type), "it has meshes"
    episodes = evaluation_episodes(env.config, 40, seed=1)
    assert play(OracleAgent(env), env, episodes).success.mean() >= 0.97
