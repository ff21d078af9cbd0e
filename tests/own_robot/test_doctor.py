"""``knowarm doctor`` of robots: refused options; the draft of a bare file is written and drawn."""

import shlex
from pathlib import Path
from types import SimpleNamespace

import pytest

from knowarm.cli.main import _parse
from knowarm.errors import UserError
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.own_robot.command import Doctor
from knowarm.world.description import read_description
from knowarm.world.robots.robot import Robot
from tests.world.helpers import EXAMPLES


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
    draft = SimpleNamespace(
        how={},
        toml=lambda file: "drafted",
        task_options=lambda: "",
        evaluation_options=lambda: "",
        success_angle_deg=30.0,
        ignore_roll=True,
        distance_m=0.05,
    )

    def check(robot: str, task: str, targets: tuple, **options: object) -> list:
        checked.append((Path(robot).read_text(), task, targets, options))
        return []

    monkeypatch.setattr("knowarm.own_robot.command.draft_robot", lambda *args: draft)
    monkeypatch.setattr("knowarm.own_robot.command.check_objects", check)
    Doctor(robot="arm.xml", task="lift").run()
    assert checked == [
        ("drafted", "lift", (), {"success_angle_deg": 30.0, "ignore_roll": True})
    ]


@pytest.mark.parametrize("angle", [" --env.success-angle-deg 60", ""])
def test_the_commands_for_an_eased_orientation_parse(
    angle: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    draft = SimpleNamespace(
        how={},
        toml=lambda file: "",
        task_options=lambda: f"{angle} --env.ignore-roll".strip(),
        evaluation_options=lambda: (
            f"{'--angle-deg 60' if angle else ''} --distance-m .05".strip()
        ),
        success_angle_deg=60.0 if angle else 15.0,
        ignore_roll=True,
        distance_m=0.05,
    )
    monkeypatch.setattr("knowarm.own_robot.command.draft_robot", lambda *args: draft)
    monkeypatch.setattr(
        "knowarm.own_robot.command.shrink_distance", lambda draft, targets: draft
    )
    monkeypatch.setattr(
        "knowarm.own_robot.command.check_robot", lambda *args, **options: []
    )
    Doctor(robot="arm.xml", write=tmp_path / "arm.toml").run()
    printed = [
        line for line in capsys.readouterr().out.splitlines() if "  knowarm" in line
    ]
    found = {}
    for words in (shlex.split(line)[1:] for line in printed):
        if words[0] != "train":  # the run's config would read the description
            found.setdefault(words[0], _parse(words[0], words[1:]))
    order = ["doctor", "view", "evaluate", "train", "evaluate"]
    assert [line.split()[1] for line in printed] == order
    for name, default in {"doctor": 15, "view": None}.items():
        wanted = 60 if angle else default
        assert (found[name].angle_deg, found[name].ignore_roll) == (wanted, True)
    degrees = 60 if angle else EvaluationConfig().angle_deg
    oracle = found["evaluate"]
    assert (oracle.evaluation.angle_deg, oracle.env.ignore_roll) == (degrees, True)
    assert (oracle.evaluation.distance_m, found["doctor"].distance_m) == (0.05, 0.05)


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
