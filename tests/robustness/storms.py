"""Campaigns against running programs: kill -9 and random steps."""

import dataclasses
import hashlib
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
import psutil
import torch

from knowarm.experiment.config import InterimConfig
from knowarm.experiment.csv_log import read_csv
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run import train
from knowarm.experiment.run_folder import RunFolder
from knowarm.experiment.run_lock import lock_folder
from knowarm.learn.checkpoint import read_checkpoint
from knowarm.report import write_report
from knowarm.world.config import EnvConfig
from knowarm.world.envs.vector_env import ArmVectorEnv
from tests.learn.a3c.test_trainer import FAST
from tests.tiny import short

GONE_S = 120
"""Time that child processes of a killed trainer have to disappear [s]."""

STEPS = 20
"""Environment steps of one update of the storms' trainings."""


def storm_config(kind: str, total_steps: int):
    """Return a small training of a kind: "ppo", "ppo with helpers" or "a3c"."""
    values = {
        "total_steps": total_steps,
        "checkpoint_every_steps": 2 * STEPS,
        "interim": InterimConfig(every_steps=10 * STEPS, episodes=2),
    }
    config = short(**values)
    if kind == "ppo with helpers":
        algorithm = dataclasses.replace(
            config.algorithm, num_envs=32, rollout_steps=5, minibatches=2, processes=2
        )
        return dataclasses.replace(config, algorithm=algorithm)
    if kind == "a3c":
        algorithm = dataclasses.replace(FAST, envs_per_worker=4, log_every_steps=2 * STEPS)
        config = experiment_config("irb120-full-a3c")
        return dataclasses.replace(config, **values, algorithm=algorithm)
    return config


def train_until_killed(kind: str, runs: Path, total_steps: int) -> None:
    """Train, or resume the training in ``runs``."""
    torch.set_num_threads(1)
    config = storm_config(kind, total_steps)
    started = next(runs.rglob("config.json"), None) is not None
    train(config, runs, resume=started, policy={"features": 8})


def kill_storm(kind: str, kills: int, seed: int) -> tuple[int, list[str]]:
    """Kill a training again and again; check its folder each time and its result at the end."""
    random, failures = np.random.default_rng(seed), []
    total, killed = STEPS * 8 * (kills + 2) * (8 if kind != "ppo" else 1), 0
    with tempfile.TemporaryDirectory() as temporary:
        runs, step = Path(temporary) / "störm runs", 0
        folder = runs / storm_config(kind, total).name / "0"
        for number in range(kills):
            process = _start(kind, runs, total)
            _wait_for_rows(folder, int(random.integers(1, 5)), process)
            time.sleep(random.random() * 0.05)
            family = _family(process.pid)
            if process.exitcode is not None:  # all steps were taken; later kills would be none
                failures += [f"{kind} {number}: it failed"] if process.exitcode else []
                break
            process.kill()
            killed += 1
            process.join()
            _, alive = psutil.wait_procs(family, timeout=GONE_S)
            failures += [f"{kind} {number}: {child} lives on" for child in alive]
            try:
                now = _check_folder(folder)
            except Exception as error:
                failures.append(f"{kind} {number}: {type(error).__name__}: {error}")
                continue
            if now < step:
                failures.append(f"{kind} {number}: the checkpoint went from {step} back to {now}")
            step = now
        if kind == "ppo":
            failures += _compare_with_uninterrupted(kind, runs, total, Path(temporary) / "whole")
    return killed, failures


def _train_silently(kind: str, runs: Path, total: int) -> None:
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 2)
    train_until_killed(kind, runs, total)


def _start(kind: str, runs: Path, total: int) -> BaseProcess:
    """Start a trainer; where possible by fork, which saves the seconds that imports take."""
    method = "fork" if sys.platform.startswith("linux") else "spawn"
    context = multiprocessing.get_context(method)
    process = context.Process(target=_train_silently, args=(kind, runs, total))
    process.start()
    return process


def _wait_for_rows(folder: Path, rows: int, process: BaseProcess) -> None:
    """Wait until the curves have changed some times, or the training has ended."""
    sizes: list[int] = []
    path = folder / "metrics.csv"
    while len(sizes) <= rows and process.is_alive():
        size = path.stat().st_size if path.exists() else 0
        if not sizes or size != sizes[-1]:
            sizes.append(size)
        time.sleep(0.005)


def _family(pid: int) -> list[psutil.Process]:
    try:
        return psutil.Process(pid).children(recursive=True)
    except psutil.Error:
        return []


def _check_folder(folder: Path) -> int:
    """Check what a killed training leaves; return the step of its checkpoint."""
    with lock_folder(folder, remedy="The lock of a killed process must be free."):
        pass
    if not (folder / "config.json").exists():
        return 0  # killed before the run was described
    run = RunFolder.open(folder)
    run.experiment()
    for path in (run.metrics_path, run.evaluations_path):
        if path.exists():
            read_csv(path)
    if not run.has_checkpoint:
        return 0
    for name in ("latest", "previous"):
        if (run.checkpoints / name).is_dir():
            return int(read_checkpoint(run.checkpoints / name).facts["step"])
    raise AssertionError("no checkpoint")


def _compare_with_uninterrupted(kind: str, runs: Path, total: int, whole: Path) -> list[str]:
    for folder in (runs, whole):
        process = _start(kind, folder, total)
        process.join()
        if process.exitcode:
            return [f"{kind}: the training to the end failed"]
    name = Path(storm_config(kind, total).name) / "0" / "checkpoints" / "latest"
    digests = [
        hashlib.sha256((folder / name / "policy.safetensors").read_bytes()).hexdigest()
        for folder in (runs, whole)
    ]
    return [] if digests[0] == digests[1] else [f"{kind}: other parameters than uninterrupted"]


EVALUATE = """
import sys
from knowarm.experiment.evaluate import evaluate

while True:
    evaluate(sys.argv[1], episodes=2, probes=[{"kind": "films", "episodes": 1}], label="storm")
    print("written", flush=True)
"""


def kill_evaluations(kills: int, seed: int) -> tuple[int, list[str]]:
    """Kill a process that evaluates; a folder with a summary must be complete."""
    random, failures = np.random.default_rng(seed), []
    with tempfile.TemporaryDirectory() as temporary:
        config = storm_config("ppo", STEPS)
        folder = train(config, temporary, policy={"features": 8}).folder
        for number in range(kills):
            process = subprocess.Popen(
                [sys.executable, "-c", EVALUATE, folder.path],
                stdout=subprocess.PIPE,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
            )
            process.stdout.readline()
            time.sleep(random.random() * 0.3)
            process.kill()
            process.communicate()
            try:
                write_report([folder.path], Path(temporary) / "report.html")
            except Exception as error:
                failures.append(f"evaluation {number}: {type(error).__name__}: {error}")
    return kills, failures


def random_steps(robot: str, steps: int, seed: int) -> tuple[int, list[str]]:
    """Step a robot with random actions; images, rewards and poses must stay within bounds."""
    config = EnvConfig(robot=robot, image_size=16, colours="randomized")
    env, random, failures = ArmVectorEnv(config, 50), np.random.default_rng(seed), []
    env.reset(seed=seed)
    done = 0
    try:
        while done < steps:
            actions = random.integers(7, size=env.action_space.shape)
            image, reward, _, _, _ = env.step(actions)
            done += 50
            if not np.isfinite(reward).all() or image.dtype != np.uint8:
                failures.append(f"{robot} at step {done}: a reward or image out of bounds")
            if not np.isfinite(env.simulation.batch.bind("qpos")).all():
                failures.append(f"{robot} at step {done}: a joint angle is not finite")
    finally:
        env.close()
    return done, failures
