"""Known arms: complete descriptions, found in a checkout, and a clear error where it is missing."""

import tomllib
from pathlib import Path

import pytest

import knowarm
from knowarm.cli.list import List
from knowarm.errors import UserError
from knowarm.world.description import read_description
from knowarm.world.robots import KNOWN_ARMS, ROBOTS, find_robot
from knowarm.world.robots.robot import Robot


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A Menagerie whose files are empty."""
    for file in KNOWN_ARMS.values():
        inside = tomllib.loads(file.read_text())["mjcf"].removeprefix("menagerie:")
        (tmp_path / inside).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / inside).touch()
    monkeypatch.setenv("KNOWARM_MENAGERIE", str(tmp_path))
    return tmp_path


def test_descriptions_are_complete_and_named(checkout: Path) -> None:
    assert len(KNOWN_ARMS) >= 6
    assert not set(KNOWN_ARMS) & set(ROBOTS)
    for name in KNOWN_ARMS:
        robot = find_robot(name)
        assert robot.name == name
        assert robot.title != name
        assert robot.mjcf.is_relative_to(checkout)
        assert robot.mjcf.is_file()
        assert len(robot.joints) >= 5


def test_robot_descriptions_cache_is_searched(
    checkout: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("KNOWARM_MENAGERIE")
    cache = checkout.parent / "descriptions"
    cache.mkdir()
    checkout.rename(cache / "mujoco_menagerie")
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(cache))
    assert all(find_robot(name).mjcf.is_file() for name in KNOWN_ARMS)


def test_missing_files_say_how_to_get_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("KNOWARM_MENAGERIE", str(tmp_path))
    name = next(iter(KNOWN_ARMS))
    with pytest.raises(
        UserError, match=r"git clone .*mujoco_menagerie.*KNOWARM_MENAGERIE"
    ):
        knowarm.make(name)
    List(kind="robots").run()
    printed = capsys.readouterr().out
    assert name in printed
    assert "missing" in printed
    assert "git clone" in printed


def test_own_file_names_a_menagerie_file(checkout: Path, tmp_path: Path) -> None:
    source = next(iter(KNOWN_ARMS.values()))
    own = tmp_path / "own.toml"
    own.write_text(source.read_text())
    assert read_description(own, Robot).mjcf == read_description(source, Robot).mjcf
