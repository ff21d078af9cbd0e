import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.experiment import provenance as provenance_module
from knowarm.experiment.csv_log import CsvLog, read_csv
from knowarm.experiment.run_folder import RunFolder


def test_the_commit_of_another_project_is_not_taken_for_the_packages(
    tmp_path, monkeypatch
):
    def git(*words):
        identity = ("-c", "user.name=a", "-c", "user.email=a@example.org")
        subprocess.run(
            ["git", "-C", tmp_path, *identity, *words], check=True, capture_output=True
        )

    git("init")
    installed = tmp_path / "venv" / "knowarm" / "provenance.py"
    installed.parent.mkdir(parents=True)
    installed.touch()
    git("commit", "--allow-empty", "-m", "theirs")
    monkeypatch.setattr(provenance_module, "__file__", str(installed))
    assert provenance_module.provenance().commit is None
    git("add", str(installed))
    git("commit", "-m", "ours")
    assert len(provenance_module.provenance().commit) == 40


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, r"has no config\.json"),
        *((text, "no JSON object") for text in ("[]", "3")),
        *((text, "config.json is damaged or of another format") for text in ("{", "")),
        ('{"format": 99}', "format 99"),
    ],
)
def test_what_is_no_run_folder_is_refused(tmp_path, text, words):
    if text is not None:
        (tmp_path / "config.json").write_text(text)
    with pytest.raises(UserError, match=words):
        RunFolder.open(tmp_path)
    with pytest.raises(UserError, match="does not exist"):
        RunFolder.open(tmp_path / "nowhere")


def test_a_config_that_is_nested_deep_is_one_line(tmp_path):
    (tmp_path / "config.json").write_text(
        '{"format": 1, "a": ' + '{"b": ' * 600 + "1" + "}" * 601
    )
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(500)
    try:
        with pytest.raises(UserError, match=r"config\.json"):
            RunFolder.open(tmp_path)
    finally:
        sys.setrecursionlimit(limit)


def test_knowledge_survives_the_disk(tmp_path):
    folder = RunFolder.create(tmp_path)
    table = np.arange(6, dtype=np.float32).reshape(2, 3)
    folder.write_knowledge(table)
    np.testing.assert_array_equal(folder.knowledge(), table)
    (tmp_path / "knowledge.safetensors").write_bytes(b"broken")
    with pytest.raises(UserError, match="damaged"):
        folder.knowledge()


def test_a_log_takes_new_columns(tmp_path):
    log = CsvLog(tmp_path / "metrics.csv")
    log.write({"step": 1, "loss": 0.5})
    log.write({"step": 2, "loss": 0.25, "entropy": 1.0})
    log.write({"step": 3, "loss": 0.125})
    rows = read_csv(tmp_path / "metrics.csv")
    assert [row["entropy"] for row in rows] == ["", "1.0", ""]
    assert [row["loss"] for row in rows] == ["0.5", "0.25", "0.125"]


def test_resuming_drops_the_rows_that_will_come_again(tmp_path):
    path = tmp_path / "metrics.csv"
    log = CsvLog(path)
    for step in (10, 20, 30):
        log.write({"step": step})
    path.write_text(path.read_text() + "4")  # a line cut short by a crash
    log = CsvLog(path, keep_to_step=20)
    log.write({"step": 30})
    assert [row["step"] for row in read_csv(path)] == ["10", "20", "30"]
    CsvLog(path).write({"step": 2})  # a new log replaces the old file
    assert [row["step"] for row in read_csv(path)] == ["2"]


@pytest.mark.parametrize("damage", [b"\xff", b"\0", b"x", b"", b",,,,"])
def test_one_damaged_row_does_not_block_resuming(tmp_path, damage):
    path = tmp_path / "metrics.csv"
    path.write_bytes(b"step,loss\n10,0.5\n" + damage + b"20,0.4\n30,0.3\n40,0.2\n")
    CsvLog(path, keep_to_step=30).write({"step": 50, "loss": 0.1})
    steps = [row["step"] for row in read_csv(path)]
    assert [step for step in steps if step != "20"] == ["10", "30", "50"]


def test_a_row_that_cannot_be_written_is_an_error_for_users(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    log = CsvLog(folder / "metrics.csv")
    log.write({"step": 1})
    folder.rename(tmp_path / "moved")  # while training
    with pytest.raises(
        UserError, match=r"Cannot write .*metrics\.csv: No such file.*resume"
    ):
        log.write({"step": 2})
    with pytest.raises(UserError, match="Cannot read"):
        log.write({"step": 2, "new": 1})


def test_a_damaged_header_is_named_before_training_goes_on(tmp_path):
    path = tmp_path / "metrics.csv"
    path.write_bytes(b"st\xffp,loss\n10,0.5\n")
    with pytest.raises(
        UserError, match=r"names no column step\. Restore the file, or move it"
    ):
        CsvLog(path, keep_to_step=30)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux's /dev/full")
def test_a_full_disk_is_an_error_for_users(tmp_path):
    log = CsvLog(tmp_path / "metrics.csv")
    log.write({"step": 1})
    (tmp_path / "metrics.csv").unlink()
    (tmp_path / "metrics.csv").symlink_to("/dev/full")
    with pytest.raises(UserError, match="No space left on device"):
        log.write({"step": 2})
