"""`knowarm train` from a signal to its exit code, and on from the command that it prints."""

import itertools
import os
import random
import shlex
import shutil
import signal
import subprocess
import sys
import time

import pytest

from knowarm.cli.main import main
from knowarm.experiment.csv_log import read_csv
from knowarm.experiment.run import train
from knowarm.experiment.run_folder import RunFolder
from tests.thorough import thorough
from tests.tiny import ALGORITHM, flags

WAIT_S = 120.0
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows cannot fork")


def rows(folder):
    return (
        folder.metrics_path.read_text().count("\n")
        if folder.metrics_path.exists()
        else 0
    )


def interrupted(arguments, folder, tmp_path, number):
    """Run a command, send it a signal after its next update, and return how it ended.

    It is a new process: a fork of one that has trained before may wait for its threads for ever.
    """
    before = max(rows(folder), 1)  # the header alone
    output = tmp_path / "output"
    with output.open("w") as file:
        running = subprocess.Popen(
            [sys.executable, "-m", "knowarm", *arguments],
            cwd=tmp_path,
            stdout=file,
            stderr=file,
        )
    try:
        deadline = time.monotonic() + WAIT_S
        while rows(folder) <= before and time.monotonic() < deadline:
            assert running.poll() is None, output.read_text()
            time.sleep(0.05)
        running.send_signal(number)
        running.wait(WAIT_S)
    finally:
        running.kill()
    return running.returncode, output.read_text()


def test_a_signal_saves_the_run_and_the_printed_command_goes_on(tmp_path):
    folder = RunFolder(tmp_path / "runs" / "irb120-bm-ppo" / "0")
    algorithm = [f"--algorithm.{name}={value}" for name, value in ALGORITHM.items()]
    # None on the way
    numbers = [
        "--total-steps=10000000",
        "--checkpoint-every-steps=10000000",
    ]
    command = [
        "train",
        "irb120-bm-ppo",
        *numbers,
        "--interim.every-steps=10000000",
        *algorithm,
    ]
    steps = [0]
    for number in (signal.SIGINT, signal.SIGTERM):
        code, output = interrupted(command, folder, tmp_path, number)
        assert code == 130, output
        steps.append(folder.checkpoint_fact("step", -1))
        assert f"Stopped at step {steps[-1]:,} and saved." in output
        again = output.split("Resume with: knowarm ")[1].splitlines()[0]
        command = shlex.split(again)
    assert steps == sorted({*steps}), "the second command goes on behind the first"


A3C = {
    "total_steps": 700,
    "checkpoint_every_steps": 200,
    "algorithm": {"workers": 2, "log_every_steps": 100},
    "interim": {"every_steps": 100, "episodes": 2},
}
"""Seven updates, with a checkpoint after every second and an evaluation after each."""
NAME = "irb120-bm-a3c"


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    return train(NAME, tmp_path_factory.mktemp("uninterrupted"), **A3C).folder


def content(folder):
    """Return the bytes of the checkpoints, and the curves without times."""
    files = itertools.product(("latest", "best"), ("policy", "optimizer", "state"))
    stored = [
        (folder.checkpoints / which / f"{part}.safetensors").read_bytes()
        for which, part in files
    ]
    curves = [read_csv(path) for path in (folder.metrics_path, folder.evaluations_path)]
    for row in curves[0]:
        del row["wall_time_s"], row["steps_per_s"]
    return stored, curves


@pytest.mark.parametrize("number", range(thorough(1, 4)))
def test_a_run_killed_at_a_random_moment_goes_on_from_a_copy_to_the_same_bytes(
    tmp_path, uninterrupted, number
):
    folder = RunFolder(tmp_path / "runs" / NAME / "0")
    moment = random.Random(number).uniform(1, 7)
    command = [
        sys.executable,
        "-m",
        "knowarm",
        "train",
        NAME,
        "--runs",
        str(tmp_path / "runs"),
    ]
    running = subprocess.Popen([*command, *flags(A3C)], stderr=subprocess.DEVNULL)
    while rows(folder) <= moment and running.poll() is None:
        time.sleep(0.01)
    time.sleep(moment % 1 * 0.05)  # anywhere within an update
    running.kill()
    assert running.wait() == -signal.SIGKILL, "it ended before it was killed"
    shutil.copytree(tmp_path / "runs", tmp_path / "copy")
    again = train(NAME, tmp_path / "copy", resume=True, **A3C)
    assert again.result.reason == "finished"
    assert content(again.folder) == content(uninterrupted)


def test_a_run_in_slices_equals_an_uninterrupted_one(tmp_path, uninterrupted, capsys):
    command = ["train", NAME, "--runs", str(tmp_path), *flags(A3C), "--until-step"]
    assert main([*command, "150"]) == 0
    printed = capsys.readouterr().out
    assert "Paused at step 200 of 700 and saved" in printed
    again = shlex.split(printed.split("Resume with: knowarm ")[1].splitlines()[0])
    assert "--until-step" not in again
    assert RunFolder(tmp_path / NAME / "0").experiment().total_steps == 700
    paused = train(NAME, tmp_path, resume=True, until_step=400, **A3C)
    assert (paused.result.step, paused.result.reason) == (400, "stopped")
    assert main(again) == 0
    assert content(RunFolder(tmp_path / NAME / "0")) == content(uninterrupted)
