import logging
import multiprocessing
import os
import signal
import sys
from dataclasses import replace
from pathlib import Path

import psutil
import pytest
import torch

from knowarm.learn.algorithms import PPOConfig
from knowarm.learn.checkpoint import CheckpointStore
from knowarm.learn.parallel.processes import ChildProcess, process_context
from tests.learn.a3c.test_stop import UPDATE, build
from tests.learn.toys import noisy_learner


def test_fewer_processes_than_asked_for_are_said(caplog):
    config = PPOConfig(
        num_envs=8, rollout_steps=4, minibatches=1, processes=2, device="cpu"
    )
    with caplog.at_level(logging.WARNING, "knowarm.learn"):
        noisy_learner(config)
    assert "processes=2 is reduced to 1: minibatches have 8 environments" in caplog.text


def send_one(connection):
    connection.send(1)


def answer(connection):
    connection.send("ready")
    connection.send(connection.recv())


def test_a_process_is_started_although_the_fork_server_ended_meanwhile(monkeypatch):
    context = process_context()
    start, attempts = context.Process.start, []

    def start_late(process):
        attempts.append(process)
        if len(attempts) < 8:
            raise EOFError if len(attempts) == 1 else ConnectionRefusedError
        start(process)

    monkeypatch.setattr(context.Process, "start", start_late)
    child = ChildProcess.start(context, "helper", send_one)
    assert child.connection.recv() == 1
    child.stop()
    assert len(attempts) == 8
    monkeypatch.setattr(
        context.Process, "start", lambda process: start_late(attempts.clear())
    )
    monkeypatch.setattr("knowarm.learn.parallel.processes.START_S", 0.1)
    with pytest.raises(EOFError):
        ChildProcess.start(context, "helper", send_one)


@pytest.mark.skipif(
    "forkserver" not in multiprocessing.get_all_start_methods(),
    reason="no fork server here",
)
def test_children_outlive_the_terminal_until_the_trainer_has_asked_for_their_states():
    context = process_context()
    child = ChildProcess.start(context, "helper", answer)
    assert child.connection.recv() == "ready"
    server = psutil.Process(child.process.pid).parent()
    for pid in (child.process.pid, server.pid):
        os.kill(pid, signal.SIGHUP)
        os.kill(pid, signal.SIGINT)
    child.send("state")
    assert child.connection.recv() == "state"
    other = ChildProcess.start(context, "helper", send_one)
    assert psutil.Process(other.process.pid).parent() == server
    for each in (child, other):
        each.stop()


def raise_end_of_file(connection):
    raise EOFError("Compressed file ended")


def test_an_end_of_file_in_a_child_is_not_taken_for_the_end_of_the_parent():
    child = ChildProcess.start(process_context(), "helper", raise_end_of_file)
    assert "Compressed file ended" in child.connection.recv().traceback
    child.stop()


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_the_fork_server_imports_torch_once_for_all_children():
    child = ChildProcess.start(process_context(), "helper", send_one)
    server = Path("/proc", str(psutil.Process(child.process.pid).ppid()))
    assert "forkserver" in (server / "cmdline").read_text()
    assert "libtorch_cpu" in (server / "maps").read_text()
    child.stop()


@pytest.mark.slow
def test_helpers_and_workers_start_by_spawn(monkeypatch, tmp_path):
    """As on Windows, which has no fork server."""
    monkeypatch.setattr(multiprocessing, "get_all_start_methods", lambda: ["spawn"])
    assert process_context().get_start_method() == "spawn"
    config = PPOConfig(num_envs=32, rollout_steps=6, minibatches=2, processes=2)
    learner, alone = noisy_learner(config), noisy_learner(replace(config, processes=1))
    env_ids = torch.arange(16)
    with learner.running(), alone.running():
        together, expected = (
            learner.compute_gradient(env_ids),
            alone.compute_gradient(env_ids),
        )
        torch.testing.assert_close(together, expected)
    gate = tmp_path / "gate"
    gate.touch()
    trainer, evaluations = build(
        gate, CheckpointStore(tmp_path / "é", {}), evaluate_every=UPDATE
    )
    assert trainer.train(2 * UPDATE).reason == "finished"
    assert [step for step, *_ in evaluations] == [0, UPDATE, 2 * UPDATE]
