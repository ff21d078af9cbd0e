"""The commands of `knowarm study`."""

import contextlib
import io
import json
import shutil
from pathlib import Path

import pytest
from rich.console import Console

from knowarm.cli.main import main
from knowarm.cli.study import status_tables, study_progress
from knowarm.errors import UserError
from knowarm.study.config import SHIPPED, read_study, write_study
from knowarm.study.driver import open_study
from knowarm.study.status import FAILURE, study_status
from knowarm.study.worker import record_failure
from tests.study.tiny import TOML


def test_studies_are_shown(capsys, tmp_path):
    assert main(["study", "show"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in SHIPPED)
    assert main(["study", "show", "paper"]) == 0
    out = capsys.readouterr().out
    assert SHIPPED["paper"].read_text() in out
    assert all(cell in out for cell in read_study("paper").cells())


def test_status_retry_stop_and_pack(capsys, tmp_path, finished, inline):
    out = shutil.copytree(finished, tmp_path / "tiny")
    record_failure(out / "irb120-bm-ppo" / "0", "a reason")
    file = tmp_path / "status.json"
    assert main(["study", "status", str(out), "--json", str(file)]) == 0
    assert "irb120-bm-ppo/0 failed: a reason" in capsys.readouterr().out
    values = json.loads(file.read_text())
    assert values["states"] == {"failed": 1, "done": 1}
    assert [run["state"] for run in values["runs"]] == ["failed", "done"]
    assert main(["study", "retry", str(out), "irb120-bm-ppo"]) == 0
    assert not (out / "irb120-bm-ppo" / "0" / FAILURE).exists()
    assert main(["study", "stop", str(out)]) == 0
    assert "Nothing is running" in capsys.readouterr().out
    assert main(["study", "pack", str(out)]) == 0
    assert (
        main(["study", "unpack", f"{out}.tar.xz", "--out", str(tmp_path / "again")])
        == 0
    )
    command = capsys.readouterr().out.partition("Report: knowarm ")[2].split()
    assert main(command) == 0
    assert (tmp_path / "again" / "report.html").exists()
    assert main(["study", "run", str(tmp_path / "again")]) == 0
    assert "Complete" in capsys.readouterr().out
    assert main(["study", "run", str(out)]) == 0
    assert "Complete" in capsys.readouterr().out


def test_a_study_runs_in_slices(capsys, tmp_path, inline):
    (tmp_path / "mine.toml").write_text(TOML)
    out = str(tmp_path / "out")
    command = ["study", "run", str(tmp_path / "mine.toml"), "--out", out]
    assert main([*command, "--until-step", "15"]) == 0
    assert "Paused at step 15 of each run" in capsys.readouterr().out
    assert main(["study", "status", out]) == 0
    printed = capsys.readouterr().out
    for words in (
        "best return",
        "steps/s",
        "irb120-bm-ppo/1 paused: at step 20; goes on",
    ):
        assert words in printed
    assert main(["study", "pack", out, "--with-checkpoints"]) == 0
    assert (
        main(["study", "unpack", f"{out}.tar.xz", "--out", str(tmp_path / "again")])
        == 0
    )
    assert main(["study", "run", str(tmp_path / "again")]) == 0
    assert "Complete" in capsys.readouterr().out


def test_this_folder_is_packed_and_other_runs_are_named(
    capsys, tmp_path, finished, monkeypatch
):
    out = shutil.copytree(finished, tmp_path / "tiny")
    shutil.copytree(out / "irb120-bm-ppo" / "0", out / "irb120-bm-ppo" / "7")
    monkeypatch.chdir(out)
    assert main(["study", "pack", "."]) == 0
    assert (
        "Left out: irb120-bm-ppo/7 is no run of the study." in capsys.readouterr().out
    )
    assert (tmp_path / "tiny.tar.xz").is_file()


def test_a_shipped_name_is_never_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "smoke").mkdir()
    write_study(read_study("smoke"), tmp_path / "smoke")
    places = []
    monkeypatch.setattr(
        "knowarm.cli.study.run_study",
        lambda study, out, **options: places.append(out) or [],
    )
    for name in ("smoke", "./smoke"):
        main(["study", "run", name])
    assert places == [Path("runs/smoke"), Path("smoke")]


@pytest.mark.parametrize(
    ("name", "old", "new", "state"),
    [
        ("metrics.csv", "\n40,", "\nabc,", "done"),
        ("metrics.csv", "\n40,", "\ninf,", "done"),
        ("evaluations.csv", "\n40,", "\nnan,", "done"),
        ("evaluations.csv", "step,", "stop,", "damaged"),
        ("checkpoints/latest/meta.json", '"step": 40', '"step": 1e999', "done"),
        ("evaluation/final/summary.json", '"success":', '"x":', "trained"),
        ("config.json", '"seed"', '"sead"', "done"),
    ],
)
def test_damage_to_one_run_leaves_the_others(
    capsys, tmp_path, finished, inline, name, old, new, state
):
    out = shutil.copytree(finished, tmp_path / "tiny")
    file = next(out.glob(f"irb120-bm-ppo/0/{name.replace('final', '*')}"))
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    table = tmp_path / "status.json"
    assert main(["study", "status", str(out), "--json", str(table)]) == 0
    assert [run["state"] for run in json.loads(table.read_text())["runs"]] == [
        state,
        "done",
    ]
    assert ("irb120-bm-ppo/0 damaged: " in capsys.readouterr().out) == (
        state == "damaged"
    )
    assert main(["report", str(out), "--out", str(tmp_path / "r.html")]) == 0
    with contextlib.suppress(SystemExit):  # exit code 1: one run is not done
        assert main(["study", "run", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "Wrote" in printed
    assert "knowarm study retry" not in printed
    assert ("Repair or remove" in printed) == (state == "damaged")


def test_a_study_of_very_many_runs_is_refused_where_it_is_read(tmp_path, finished):
    out = shutil.copytree(finished, tmp_path / "tiny")
    values = json.loads((out / "study.json").read_text())
    (out / "study.json").write_text(
        json.dumps(values | {"seeds": list(range(100_000))})
    )
    with pytest.raises(UserError, match="at most 2,000 runs"):
        read_study(out)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "papper"], "'paper'"),
        (["run", "mine.toml", "--seeds", "1", "1"], "given twice"),
        (["run", "mine.toml", "--cores", "100000"], "where.cores"),
        (["status", "."], "holds no study"),
        (["shwo"], "'show'"),
    ],
)
def test_mistakes_end_in_one_line_and_nothing_is_written(
    capsys, tmp_path, monkeypatch, arguments, words
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(TOML)
    assert main(["study", *arguments]) == 2
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["mine.toml"]


def test_the_display_shows_states_as_table_or_lines(capsys, finished):
    study = open_study(finished)
    statuses = study_status(study, finished)
    file = io.StringIO()
    Console(file=file, width=120).print(*status_tables(study, statuses, 120), sep="\n")
    assert "irb120-bm-ppo" in file.getvalue()
    assert file.getvalue().count("done") == 3
    with study_progress(study) as show:
        show(statuses)
        show(statuses)
    out = capsys.readouterr().out
    assert out.count("irb120-bm-ppo/0 done") == 1
    assert out.count("2 runs: 2 done.") == 1
