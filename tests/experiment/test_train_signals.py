"""`knowarm train` from a signal to its exit code, and on from the command that it prints."""

import os
import shlex
import signal
import time

import pytest

from knowarm.cli.main import main
from knowarm.experiment.run_folder import RunFolder
from tests.forked import Forked
from tests.tiny import ALGORITHM

WAIT_S = 120.0
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows cannot fork")


def rows(folder):
    return folder.metrics_path.read_text().count("\n") if folder.metrics_path.exists() else 0


def interrupted(arguments, folder, tmp_path, number):
    """Run a command, send it a signal after its next update, and return how it ended."""
    before = max(rows(folder), 1)  # the header alone
    running = Forked(lambda: main(arguments), tmp_path, cwd=tmp_path)
    try:
        deadline = time.monotonic() + WAIT_S
        while rows(folder) <= before and time.monotonic() < deadline:
            assert not running.ended(0.05), running.stderr
        os.kill(running.process.pid, number)
        assert running.ended(WAIT_S)
    finally:
        running.process.kill()
    return running


def test_a_signal_saves_the_run_and_the_printed_command_goes_on(tmp_path):
    folder = RunFolder(tmp_path / "runs" / "irb120-bm-ppo" / "0")
    algorithm = [f"--algorithm.{name}={value}" for name, value in ALGORITHM.items()]
    numbers = ["--total-steps=10000000", "--checkpoint-every-steps=10000000"]  # none on the way
    command = ["train", "irb120-bm-ppo", *numbers, "--interim.every-steps=10000000", *algorithm]
    steps = [0]
    for number in (signal.SIGINT, signal.SIGTERM):
        running = interrupted(command, folder, tmp_path, number)
        assert running.returncode == 130, running.stderr
        steps.append(folder.checkpoint_fact("step", -1))
        assert f"Stopped at step {steps[-1]:,} and saved." in running.stdout
        again = running.stdout.split("Resume with: knowarm ")[1].splitlines()[0]
        command = shlex.split(again)
    assert steps == sorted({*steps}), "the second command goes on behind the first"
