"""``knowarm doctor`` of robots: refused options; the draft of a bare file is written and drawn."""

import shlex
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from mujoco import MjModel

from knowarm.cli.main import _parse
from knowarm.config import override
from knowarm.errors import UserError
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.experiment.names import experiment_config
from knowarm.own_robot.command import Doctor
from knowarm.own_robot.draft import Draft
from knowarm.world.agents import OracleAgent
from knowarm.world.config import EnvConfig
from knowarm.world.description import read_description
from knowarm.world.robots import find_robot
from knowarm.world.robots.robot import Robot
from tests.own_robot.robot_cases import as_urdf
from tests.world.helpers import EXAMPLES, write_robot

pytestmark = pytest.mark.usefixtures("unfenced")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"set": ("home=[0]",)}, "--set needs --robot"),
        ({"targets": ("bowl.toml",)}, "--targets needs --robot"),
        (
            {"robot": str(EXAMPLES / "scara.xml"), "set": ("joints=5",)},
            "a list of names, got 5",
        ),
        (
            {"robot": "irb120", "write": Path("a.toml")},
            "--write needs --robot with an MJCF, URDF or",
        ),
        (
            {"robot": "arm.xml", "write": Path("a.txt")},
            "--write must name a .toml file",
        ),
        (
            {"robot": "arm.xml", "write": Path("my arm.toml")},
            "as runs are named after it, got my arm.toml. Take my_arm.toml.",
        ),
        ({"robot": "missing.xml"}, "no such file"),
        ({"package": ("a=b",)}, "--package needs --robot"),
    ],
)
def test_options_that_do_not_fit_are_refused(options: dict, words: str) -> None:
    with pytest.raises(UserError, match=words):
        Doctor(**options).run()


@pytest.mark.slow
def test_draft_is_written_and_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], short_search: None
) -> None:
    file, image = tmp_path / "scara.toml", tmp_path / "scara.png"
    doctor = Doctor(
        robot=str(EXAMPLES / "scara.xml"),
        targets=("bottle",),
        set=("camera_fovy_deg=45",),
        write=file,
        image=image,
    )
    try:
        doctor.run()
    except UserError as error:
        assert "checks failed" in str(error)  # noqa: PT017
    assert read_description(file, Robot).camera_fovy_deg == 45
    assert image.stat().st_size > 1000
    assert "TCP" in capsys.readouterr().out


def test_a_model_file_is_drafted_and_checked_for_a_task(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checked = []
    draft = SimpleNamespace(how={}, toml=lambda file: "drafted")

    def check(robot: str, task: str, targets: tuple, **options: object) -> list:
        checked.append((Path(robot).read_text(), task, targets, options))
        return []

    monkeypatch.setattr("knowarm.own_robot.command.draft_robot", lambda *args: draft)
    monkeypatch.setattr("knowarm.own_robot.command.check_objects", check)
    Doctor(robot="arm.xml", task="lift").run()
    Doctor(robot="arm.xml", task="lift", angle_deg=30.0, ignore_roll=True).run()
    options = [
        {"success_angle_deg": 0.0, "ignore_roll": False},
        {"success_angle_deg": 30.0, "ignore_roll": True},
    ]
    assert checked == [("drafted", "lift", (), option) for option in options]


STATED = {
    "success_distance_m": "0.03",
    "success_angle_deg": "60.0",
    "ignore_roll": "true",
    "evaluation_distance_m": "0.04",
}


def test_the_printed_commands_parse_and_read_the_thresholds_of_the_description(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    folder = tmp_path / "My Arm"
    folder.mkdir()
    text = write_robot(folder, **STATED).read_text()
    draft = SimpleNamespace(how={}, toml=lambda file: text)
    here = "knowarm.own_robot.command."
    checked = []
    monkeypatch.setattr(here + "draft_robot", lambda *args: draft)
    monkeypatch.setattr(here + "repair_draft", lambda draft, *args: draft)
    monkeypatch.setattr(here + "shrink_distance", lambda draft, targets: draft)
    monkeypatch.setattr(
        here + "check_robot",
        lambda *args, **options: checked.append(options) or [],
    )
    file = folder / "arm.toml"
    Doctor(robot="arm.xml", write=file).run()
    assert checked == [{"angle_deg": None, "ignore_roll": False, "distance_m": None}]
    printed = [
        line for line in capsys.readouterr().out.splitlines() if "  knowarm" in line
    ]
    found = {}
    for words in (shlex.split(line)[1:] for line in printed):
        found.setdefault(words[0], _parse(words[0], words[1:]))
    order = ["doctor", "view", "evaluate", "train", "evaluate"]
    assert [line.split()[1] for line in printed] == order
    for env in (
        found["evaluate"].env,
        found["train"].config.env,
        found["view"]._agent()[1],
        EnvConfig(robot=str(file)),
        experiment_config("full-fast", env={"robot": str(file)}).env,
    ):
        assert env.success_distance_m == 0.03
        assert env.success_angle_deg == 60
        assert env.ignore_roll
    judged = EvaluationConfig().of_robot(read_description(file, Robot))
    assert (judged.distance_m, judged.angle_deg) == (0.04, 60)


TOLD = {
    "targets": ("mug", "bottle"),
    "set": ("home=[0.0, 1.5]",),
    "xacro": ("dof:=6",),
    "package": ("parts=/some where",),
    "unit": "deg",
}


@pytest.mark.parametrize("is_written", [True, False])
def test_the_printed_commands_keep_what_doctor_was_told(
    is_written: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(tmp_path)
    text = write_robot(tmp_path, **STATED).read_text()
    Path("my_arm.toml").write_text(text)
    robot = SimpleNamespace(joints=("a",))
    draft = SimpleNamespace(how={}, toml=lambda file: text, robot=robot, fields={})
    here = "knowarm.own_robot.command."
    monkeypatch.setattr(here + "draft_robot", lambda *args: draft)
    monkeypatch.setattr(here + "as_mjcf", lambda *args, **options: (Path("a.xml"), ""))
    monkeypatch.setattr(here + "repair_draft", lambda draft, *args: draft)
    monkeypatch.setattr(here + "shrink_distance", lambda draft, targets: draft)
    monkeypatch.setattr(here + "check_robot", lambda *args, **options: [])
    (tmp_path / "a folder").mkdir()
    file = tmp_path / "a folder" / "arm.toml" if is_written else None
    Doctor(robot="my arm.xacro", write=file, **TOLD).run()
    printed = capsys.readouterr().out.splitlines()
    commands = [shlex.split(line)[1:] for line in printed if "  knowarm" in line]
    parsed = [_parse(words[0], words[1:]) for words in commands]
    doctor, view, oracle, train, _ = parsed
    assert view.targets == oracle.env.targets == train.config.env.targets
    assert view.targets == TOLD["targets"]
    if is_written:
        assert doctor == Doctor(robot=str(file), targets=TOLD["targets"])
    else:  # the other commands need the file
        expected = Doctor(robot="my arm.xacro", write=Path("my_arm.toml"), **TOLD)
        assert doctor == expected
    assert oracle.env.robot == ("my_arm.toml" if file is None else str(file))


def test_evaluations_are_judged_as_the_description_states(tmp_path: Path) -> None:
    robot = str(write_robot(tmp_path, **STATED))
    env = EnvConfig(robot=robot, targets=("bottle",))
    lines: list[str] = []
    few = {"episodes": 4, "probes": ()}
    summary = evaluate(OracleAgent, env, report=lines.append, **few).summary
    assert (summary.config.distance_m, summary.config.angle_deg) == (0.04, 60)
    assert summary.env["ignore_roll"]
    assert lines[0] == f"Judged within 4 cm and 60 degrees, as {robot} states."
    given = {"distance_m": 0.08, "angle_deg": 20.0, **few}
    summary = evaluate(OracleAgent, env, **given).summary
    assert (summary.config.distance_m, summary.config.angle_deg) == (0.08, 20)


def test_thresholds_that_are_given_stay_and_the_robots_follow_the_robot(
    tmp_path: Path,
) -> None:
    robot = str(write_robot(tmp_path, **STATED))
    stricter = experiment_config(
        "full-fast", env={"robot": robot, "success_distance_m": 0.05}
    )
    assert stricter.env.success_distance_m == 0.05
    back = override(stricter, {"env": {"robot": "tiago"}}).env
    assert (back.success_distance_m, back.success_angle_deg) == (0.05, 15)
    assert not back.ignore_roll
    usual = EnvConfig(robot="tiago", success_distance_m=0.02)
    other = override(usual, {"robot": robot})
    assert (other.success_distance_m, other.success_angle_deg) == (0.02, 60)
    same = override(EnvConfig(robot=robot), {"image_size": 32})
    assert (same.success_distance_m, same.ignore_roll) == (0.03, True)


@pytest.mark.parametrize("name", [*STATED][:2])
def test_thresholds_of_a_description_are_positive(name: str, tmp_path: Path) -> None:
    robot = write_robot(tmp_path, **{name: "0.0"})
    with pytest.raises(UserError, match=f"{name} must be larger than 0, got 0"):
        read_description(robot, Robot)


def test_an_installation_that_works_passes_every_check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Doctor(runs=tmp_path).run()
    out = capsys.readouterr().out
    assert "FAILED" not in out
    for check in (
        "versions",
        "knowledge",
        "world",
        "policy",
        "memory",
        "output folder",
    ):
        assert check in out


def test_a_converted_model_is_kept_beside_a_whole_draft_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A draft takes minutes, and what is killed in it cannot clean up."""
    here = "knowarm.own_robot.command."
    source = tmp_path / "source"
    source.mkdir()
    (source / "arm.urdf").write_text(as_urdf())
    folder = tmp_path / "new"
    folder.mkdir()
    doctor = Doctor(robot=str(source / "arm.urdf"), write=folder / "mine.toml")
    during = []

    def draft_robot(model: Path, *args: object) -> Draft:
        during.append([*folder.iterdir()])
        MjModel.from_xml_path(str(model))
        if len(during) == 1:
            raise KeyboardInterrupt
        robot = replace(find_robot("irb120"), mjcf=model)
        choices = {"success_angle_deg": 15.0, "ignore_roll": False, "distance_m": 0.1}
        return Draft(robot=robot, fields={"mjcf": str(model)}, how={}, **choices)

    monkeypatch.setattr(here + "draft_robot", draft_robot)
    monkeypatch.setattr(here + "repair_draft", lambda draft, *args: draft)
    monkeypatch.setattr(here + "shrink_distance", lambda draft, targets: draft)
    monkeypatch.setattr(here + "check_robot", lambda *args, **options: [])
    with pytest.raises(KeyboardInterrupt):
        doctor.run()
    doctor.run()
    assert during == [[], []]
    left = sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))
    assert left == ["mine", "mine.toml", "mine/arm.xml", "mine/meshes"]
    assert 'mjcf = "mine/arm.xml"' in (folder / "mine.toml").read_text()
    (folder / "mine.toml").unlink()
    with pytest.raises(UserError, match=r"mine for the .* exists; remove or"):
        doctor.run()
    assert len(during) == 2
