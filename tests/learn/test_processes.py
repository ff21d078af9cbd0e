import contextlib
import logging
import multiprocessing
import os
import signal
import subprocess
import sys
import time

import psutil
import pytest
import torch

from knowarm.learn import processes
from knowarm.learn.checkpoint import CheckpointStore
from knowarm.learn.config import PPOConfig
from knowarm.learn.data_parallel import make_learner
from knowarm.learn.minibatch import TrainingNetwork
from knowarm.learn.processes import ChildProcess, prepare_child_process, process_context
from tests.learn.a3c.test_stop import UPDATE, build
from tests.learn.test_data_parallel import noisy_learner
from tests.learn.toys import toy_policy

FOLDERS = """
from knowarm.learn.processes import _temporary_folder

print(_temporary_folder())
"""


def test_the_folders_of_killed_processes_are_removed(tmp_path):
    unused = next(pid for pid in range(2**22 - 1, 0, -1) if not psutil.pid_exists(pid))
    killed, used = tmp_path / f"knowarm-{unused}-abc", tmp_path / f"knowarm-{os.getpid()}-abc"
    others = tmp_path / "knowarm-notes"
    for folder in (killed, used, others):
        folder.mkdir()
        (folder / "socket").touch()
    done = subprocess.run(
        [sys.executable, "-c", FOLDERS],
        env={**os.environ, "TMPDIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.startswith(str(tmp_path))
    assert sorted(tmp_path.iterdir()) == sorted([used, others])  # its own is gone as well


def test_fewer_processes_than_asked_for_are_said(caplog):
    config = PPOConfig(num_envs=8, rollout_steps=4, minibatches=1, processes=2, device="cpu")
    with caplog.at_level(logging.WARNING, "knowarm.learn"):
        make_learner(TrainingNetwork(toy_policy(), 0), config, "float32", torch.device("cpu"))
    assert "processes=2 is reduced to 1: minibatches have 8 environments" in caplog.text


def send_one(connection):
    with contextlib.suppress(BrokenPipeError):  # of a start that was given up
        connection.send(1)


@pytest.mark.skipif(
    "forkserver" not in multiprocessing.get_all_start_methods(), reason="no fork server here"
)
@pytest.mark.parametrize("kills", [1, 2])
def test_a_fork_server_killed_while_it_starts_a_process_is_replaced(kills, monkeypatch, caplog):
    from multiprocessing import forkserver

    read, killed = forkserver.read_signed, []

    def kill_and_read(sentinel):
        if len(killed) < kills:
            server = psutil.Process(forkserver._forkserver._forkserver_pid)
            killed.append(server.pid)
            server.kill()
            while server.status() != psutil.STATUS_ZOMBIE:
                time.sleep(0.01)
            raise EOFError("unexpected EOF")
        return read(sentinel)

    monkeypatch.setattr(forkserver, "read_signed", kill_and_read)
    monkeypatch.setattr(processes, "START_ATTEMPTS", 2)
    context = process_context()
    if kills == 2:
        with pytest.raises(EOFError):
            ChildProcess.start(context, "helper", send_one)
    else:
        child = ChildProcess.start(context, "helper", send_one)
        assert child.connection.recv() == 1
        child.stop()
        assert "The fork server ended while starting the helper" in caplog.text
    assert len(set(killed)) == kills


def answer(connection):
    prepare_child_process()
    connection.send("ready")
    connection.send(connection.recv())


@pytest.mark.skipif(
    "forkserver" not in multiprocessing.get_all_start_methods(), reason="no fork server here"
)
def test_children_outlive_the_terminal_until_the_trainer_has_asked_for_their_states():
    context = process_context()
    child = ChildProcess.start(context, "helper", answer)
    assert child.connection.recv() == "ready"
    server = psutil.Process(child.process.pid).parent()
    for pid in (child.process.pid, server.pid):
        os.kill(pid, signal.SIGHUP)
    child.send("state")
    assert child.connection.recv() == "state"
    other = ChildProcess.start(context, "helper", send_one)
    assert psutil.Process(other.process.pid).parent() == server
    for each in (child, other):
        each.stop()


@pytest.mark.slow
def test_helpers_and_workers_start_by_spawn(monkeypatch, tmp_path):
    """As on Windows, which has no fork server."""
    monkeypatch.setattr(multiprocessing, "get_all_start_methods", lambda: ["spawn"])
    assert process_context().get_start_method() == "spawn"
    learner, alone = noisy_learner(2), noisy_learner(1)
    env_ids = torch.arange(16)
    with learner.running(), alone.running():
        together = learner.compute_gradient(env_ids).vector()
        torch.testing.assert_close(together, alone.compute_gradient(env_ids).vector())
    gate = tmp_path / "gate"
    gate.touch()
    trainer, evaluations = build(gate, CheckpointStore(tmp_path / "é", {}), evaluate_every=UPDATE)
    assert trainer.train(2 * UPDATE).reason == "finished"
    assert [step for step, *_ in evaluations] == [0, UPDATE, 2 * UPDATE]
