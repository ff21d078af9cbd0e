"""``knowarm doctor`` of robots: refused options; the draft of a bare file is written and drawn."""

from pathlib import Path

import pytest

from knowarm.cli.doctor import Doctor
from knowarm.errors import UserError
from knowarm.world.robots.robot import read_robot
from tests.world.helpers import EXAMPLES


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"set": ("home=[0]",)}, "--set needs --robot"),
        ({"task": "choose", "image": Path("a.png")}, "--image needs no --task"),
        ({"robot": "irb120", "write": Path("a.toml")}, "--write needs --robot with an MJCF file"),
        ({"robot": "arm.xml", "write": Path("a.txt")}, "--write must name a .toml file"),
        ({"robot": "missing.xml"}, "no such file"),
    ],
)
def test_options_that_do_not_fit_are_refused(options: dict, words: str) -> None:
    with pytest.raises(UserError, match=words):
        Doctor(**options).run()


@pytest.mark.slow
def test_draft_is_written_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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
    assert read_robot(file).camera_fovy_deg == 45
    assert image.stat().st_size > 1000
    assert "TCP" in capsys.readouterr().out
