from pathlib import Path

import pytest
from PIL import Image

from knowarm.cli.main import main
from tests.source_tree import ROOT

ZOO = str(ROOT / "zoo/irb120-full-fast")


def test_a_scripted_agent_is_drawn_as_a_strip(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    path = tmp_path / "strip.png"
    arguments = ["tiago", "--episodes", "2", "--targets", "mug", "--strip", str(path)]
    assert main(["view", *arguments]) == 0
    assert "2 of 2 episodes reached their target" in capsys.readouterr().out
    with Image.open(path) as strip:
        assert strip.height == 2 * 304 + 8


def test_without_a_file_a_page_is_opened_in_the_browser(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.chdir(tmp_path)
    arguments = ["view", "irb120", "--episodes", "1", "--dynamics", "kinematic"]
    assert main([*arguments, "--no-browser"]) == 0
    assert not opened
    assert main(arguments) == 0
    assert opened == [(tmp_path / "knowarm-view.html").as_uri()]
    assert "Wrote knowarm-view.html" in capsys.readouterr().out
    assert main([*arguments, "--strip", "strip.png"]) == 0
    assert len(opened) == 1, "a file was asked for, not a page"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["tiaga", "--strip", "x.png"], "Unknown robot 'tiaga'. Did you mean 'tiago'"),
        (["irb120", "--agent", "orakle"], "Unknown agent or run folder 'orakle'"),
        (["irb120", "--targets", "bttle", "--strip", "x.png"], "Did you mean 'bottle'"),
        (["irb120", "--episodes", "0"], "episodes must be at least 1, got 0"),
        (
            ["irb120", "--seed", "-1", "--strip", "x.png"],
            "seed must lie between 0 and 2**63 - 1, got -1",
        ),
        (["irb120", "--agent", "runs/none/0", "--strip", "x.png"], "runs/none/0"),
        (
            ["irb120", "--page", "film.png"],
            "The page must be an .html file, got 'film.png'",
        ),
        (
            ["irb120", "--angle-deg", "0", "--strip", "x.png"],
            "angle_deg must be larger than 0",
        ),
        (
            ["--agent", ZOO, "--colours", "randomized", "--strip", "x.png"],
            "does not fit this environment",
        ),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture
) -> None:
    assert main(["view", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
