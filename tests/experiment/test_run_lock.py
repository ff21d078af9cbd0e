import json
import os
import shutil
import signal
import subprocess
import sys

import pytest

from knowarm.errors import UserError
from knowarm.experiment.run import train
from knowarm.experiment.run_lock import HOLDER, LOCK, is_locked, lock_folder
from tests.tiny import short

HOLD = """
import sys
from pathlib import Path
from knowarm.experiment.run_lock import lock_folder

with lock_folder(Path(sys.argv[1]), remedy="Wait."):
    print("held", flush=True)
    sys.stdin.read()
"""


def start_holder(path):
    """Start a process that holds the lock until its input closes."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, path],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "held\n"
    return process


@pytest.fixture
def holder(tmp_path):
    process = start_holder(tmp_path / "run")
    yield process
    process.kill()
    process.communicate()


def test_one_process_at_a_time_holds_a_folder(tmp_path, holder):
    with (
        pytest.raises(
            UserError, match=rf"is in use by process {holder.pid} on .*Stop it\."
        ),
        lock_folder(tmp_path / "run", remedy="Stop it."),
    ):
        pytest.fail("the lock was given twice")
    holder.communicate()
    with lock_folder(tmp_path / "run", remedy=""):
        pass


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="Windows has no SIGKILL")
def test_the_lock_of_a_killed_process_is_free(tmp_path, holder):
    os.kill(holder.pid, signal.SIGKILL)
    holder.wait()
    with lock_folder(tmp_path / "run", remedy=""):
        pass


def test_the_lock_is_released_after_an_error(tmp_path):
    for _ in range(2):
        with pytest.raises(KeyError), lock_folder(tmp_path / "run", remedy=""):
            raise KeyError


def test_the_name_of_the_holder_is_replaced_as_a_whole(tmp_path):
    (tmp_path / HOLDER).write_text("before")
    with (tmp_path / HOLDER).open() as reader, lock_folder(tmp_path, remedy=""):
        assert reader.read() == "before"
        assert json.loads((tmp_path / HOLDER).read_text())["pid"] == os.getpid()


@pytest.mark.parametrize("recreate", [False, True])
@pytest.mark.parametrize("removed", [[LOCK], [LOCK, "x"]], ids=["removed", "twice"])
def test_a_live_process_holds_a_folder_without_its_lock_file(
    tmp_path, holder, removed, recreate
):
    """As on a network file system whose locks do nothing."""
    for _ in removed:
        (tmp_path / "run" / LOCK).unlink(missing_ok=True)
        if recreate:
            (tmp_path / "run" / LOCK).touch()
        assert is_locked(tmp_path / "run")
        with (
            pytest.raises(UserError, match=rf"is in use by process {holder.pid} on "),
            lock_folder(tmp_path / "run", remedy=""),
        ):
            pytest.fail("two processes hold the folder")


@pytest.mark.parametrize(
    "change",
    [
        {"pid": 2**31 - 1},
        {"pid": 1},
        {"started": 0.0},
        {"host": "another"},
        {"pid": "1"},
        {"pid": None},
        {"pid": -1},
        {"pid": 10**30},
        {"started": "now"},
        {"started": float("nan")},
    ],
)
def test_a_process_that_has_ended_holds_nothing(tmp_path, change):
    """The number of a killed process may belong to another one by now."""
    with lock_folder(tmp_path, remedy=""):
        stored = json.loads((tmp_path / HOLDER).read_text())
    (tmp_path / HOLDER).write_text(json.dumps(stored | change))
    assert not is_locked(tmp_path)
    with lock_folder(tmp_path, remedy=""):
        pass
    assert not (tmp_path / HOLDER).exists()


def test_a_lock_is_checked_and_restored(tmp_path):
    with lock_folder(tmp_path, remedy="Stop it.") as lock:
        lock.check()
        for names in ([LOCK], [HOLDER], [LOCK, HOLDER]):
            for name in names:
                (tmp_path / name).unlink()
            lock.check()
            assert is_locked(tmp_path)
        (tmp_path / LOCK).unlink()
        (tmp_path / HOLDER).unlink()
        process = start_holder(tmp_path)
        with pytest.raises(UserError, match=rf"is in use by process {process.pid} on "):
            lock.check()
        process.communicate()


def test_a_folder_that_another_process_took_beside_a_lock_that_locks_nothing(tmp_path):
    """As processes of two machines may on a network file system."""
    with lock_folder(tmp_path, remedy="Stop it.") as lock:
        other = json.loads((tmp_path / HOLDER).read_text()) | {
            "host": "another",
            "pid": 7,
        }
        (tmp_path / HOLDER).write_text(json.dumps(other))
        with pytest.raises(UserError, match=r"is in use by process 7 on another"):
            lock.check()
    assert json.loads((tmp_path / HOLDER).read_text()) == other


@pytest.mark.skipif(os.name == "nt", reason="Windows moves no folder in use")
@pytest.mark.parametrize("is_replaced", [False, True])
def test_a_lock_does_not_follow_a_folder_that_was_moved(tmp_path, is_replaced):
    path = tmp_path / "run"
    with lock_folder(path, remedy="Stop it.") as lock:
        path.rename(tmp_path / "moved")
        if is_replaced:
            path.mkdir()
        with pytest.raises(UserError, match=r"run.\.lock: the folder was moved"):
            lock.check()
    assert path.exists() == is_replaced
    assert not [*path.glob("*")]


def test_a_training_writes_nothing_into_a_folder_that_another_process_took(tmp_path):
    config = short(total_steps=400)
    path = tmp_path / config.name / "0"
    process = []

    def take() -> bool:
        if not process:
            (path / LOCK).unlink()
            (path / HOLDER).unlink()
            process.append(start_holder(path))
            shutil.rmtree(path / "checkpoints", ignore_errors=True)
        return False

    with pytest.raises(UserError, match="is in use by process"):
        train(config, tmp_path, should_stop=take)
    assert not (path / "checkpoints").exists()
    process[0].communicate()


@pytest.mark.parametrize("resume", [False, True])
def test_two_trainings_do_not_share_a_run_folder(tmp_path, resume, reach_run, copy_of):
    path = copy_of(reach_run).path if resume else tmp_path / short().name / "0"
    process = start_holder(path)
    before = {file: file.read_bytes() for file in path.rglob("*") if file.is_file()}
    with pytest.raises(UserError, match=rf"is in use by process {process.pid}"):
        train(short(), path.parents[1], resume=resume)
    assert {
        file: file.read_bytes() for file in path.rglob("*") if file.is_file()
    } == before
    process.communicate()


def test_a_folder_that_cannot_be_written_to_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(UserError, match=r"Cannot write .*run: Not a directory. Pass an"),
        lock_folder(tmp_path / "file" / "run", remedy=""),
    ):
        pytest.fail("locked a folder that cannot exist")


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere"
)
def test_a_read_only_folder_is_named(tmp_path):
    tmp_path.chmod(0o500)
    with (
        pytest.raises(UserError, match="Cannot write"),
        lock_folder(tmp_path, remedy=""),
    ):
        pytest.fail("locked a folder that is read-only")
