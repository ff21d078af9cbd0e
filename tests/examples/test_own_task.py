"""The example ``own_task``: trained, evaluated and reported by the commands of its docstring."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from knowarm.cli.main import _parse, main
from knowarm.experiment.summary import read_table
from knowarm.reading import read_json
from knowarm.world.tasks import VARIABLE
from knowarm.world.tasks.skills import SKILLS
from tests.tiny import TINY, flags

FOLDER = Path(__file__).parents[2] / "examples" / "own_task"


@pytest.fixture
def in_its_folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(FOLDER)
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setenv(VARIABLE, "")
    yield
    SKILLS.pop("hover", None)


def start_afresh(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget the task, as a new process does not know it."""
    SKILLS.pop("hover", None)
    monkeypatch.setenv(VARIABLE, "")


@pytest.mark.usefixtures("in_its_folder")
def test_it_is_trained_evaluated_and_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--env.task", "hover:Hover", "--runs", str(tmp_path), *flags(TINY)]
    assert main(["train", "irb120-full-ppo", *options]) == 0
    run = tmp_path / "irb120-hover-full-ppo" / "0"
    assert f"knowarm evaluate {run} --tasks hover:Hover\n" in capsys.readouterr().out
    assert read_json(run / "config.json")["env"]["task"]["skill"]["kind"] == "hover"

    start_afresh(monkeypatch)
    options = ["--episodes", "4", "--record-films", "1", "--blind-episodes", "0"]
    capsys.readouterr()
    assert main(["evaluate", str(run), *options]) == 2
    assert "'hover'" in (err := capsys.readouterr().err)
    assert "Read one of your own with `--tasks package.module:Name`" in err
    assert main(["evaluate", str(run), *options, "--tasks", "hover:Hover"]) == 0
    (evaluation,) = (run / "evaluation").iterdir()
    held = read_table(evaluation / "episodes.parquet")["held"]
    assert held.shape == (4,)
    assert (held >= 0).all()

    name, options = "irb120-hover-full-ppo", ["--tasks", "hover:Hover"]
    command = _parse("train", [name, *options])  # which Ctrl-C prints
    assert (command.again, command.own) == (
        "knowarm train irb120-hover-full-ppo --resume --tasks hover:Hover",
        " --tasks hover:Hover",
    )

    start_afresh(monkeypatch)
    page = tmp_path / "report.html"
    assert main(["report", str(run), "--out", str(page), "--tasks", "hover:Hover"]) == 0
    assert "irb120-hover-full-ppo" in page.read_text()


@pytest.mark.usefixtures("in_its_folder")
def test_it_takes_the_place_of_the_skill_that_an_agent_is_named_with() -> None:
    command = _parse(
        "train", ["irb120-choose-answers-distil", "--env.task", "hover:Hover"]
    )
    config = command.config
    assert config.name == "irb120-choose-hover-answers-distil"
    assert (config.env.task.asked.kind, config.env.task.skill.kind) == (
        "choose",
        "hover",
    )
    assert config.env.task.name == "choose-hover"
    options = ["irb120-choose-lift-bm-ppo", "--env.task", "hover:Hover"]
    assert _parse("train", options).config.env.task.name == "choose-hover"
