"""Campaign against a running study: kill -9 of its driver, its workers and their helpers."""

import os
import random
import subprocess
import sys
import tempfile
import time
import uuid
from pathlib import Path

import psutil
import pytest

from knowarm.experiment.csv_log import read_csv
from knowarm.study import driver as driver_module
from knowarm.study.driver import open_study, run_study
from knowarm.study.status import study_status
from tests.study.tiny import InlineExecutor

GONE_S = 120
"""Time that processes of a killed study have to disappear [s]."""

MARK = "KNOWARM_FAULT_TEST"
ALONE, HELPED = "irb120-bm-ppo", "irb120-full-ppo"  # without and with helper processes
STUDY = """
name = "faults"
experiments = EXPERIMENTS
seeds = SEEDS

[overrides]
total_steps = 600
checkpoint_every_steps = 60
interim = {every_steps = 300, episodes = 2}
algorithm = {num_envs = 4, rollout_steps = 5, minibatches = 2, processes = 1}

[[overrides_for]]  # helper processes
experiments = "irb120-full-ppo"
fields.total_steps = 3200
fields.checkpoint_every_steps = 300
fields.interim.every_steps = 1600
fields.algorithm = {num_envs = 32, processes = 2}

[[evaluations]]
episodes = 3
probes = []

[where]
kind = "local"
at_once = 2
retries = 100
"""


def _start(study: Path, out: Path, mark: str) -> subprocess.Popen:
    return subprocess.Popen(
        [
            sys.executable,
            "-m",
            "knowarm",
            "study",
            "run",
            str(study),
            "--out",
            str(out),
        ],
        env={**os.environ, MARK: mark},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def _alive(mark: str) -> list[psutil.Process]:
    """Return the processes that descend from a marked driver, whoever their parent is now."""
    found = []
    for process in psutil.process_iter():
        try:
            if (
                process.environ().get(MARK) == mark
                and process.status() != psutil.STATUS_ZOMBIE
            ):
                found.append(process)
        except psutil.Error:
            continue
    return found


def _shared_memory() -> set[str]:
    return {
        path.name for path in Path("/dev/shm").iterdir() if "plasma" not in path.name
    }


def _metrics_bytes(out: Path, worker: psutil.Process) -> int:
    """Return the size of the metrics of the run that a worker trains."""
    path = out.joinpath(*worker.cmdline()[-2:]) / "metrics.csv"  # experiment, seed
    return path.stat().st_size if path.exists() else 0


def _victim(
    kind: str, driver: int, out: Path, known: dict[int, int], draws: random.Random
) -> psutil.Process | None:
    """Return a random process: the driver, a worker, or a helper of a worker.

    Args:
        kind: "driver", "worker" or "helper".
        driver: process id of the driver.
        out: folder of the study.
        known: size of the metrics when a helper was last killed, by process id of its worker. A
            helper is chosen only after progress: three lost ones without end a training by design.
        draws: generator of the choice.
    """
    if kind == "driver":
        return psutil.Process(driver)
    workers = psutil.Process(driver).children()
    if kind == "worker":
        return draws.choice(workers) if workers else None
    sizes = {worker: _metrics_bytes(out, worker) for worker in workers}
    workers = [
        worker for worker, size in sizes.items() if known.get(worker.pid) != size
    ]
    helpers = {
        child: worker for worker in workers for child in worker.children(recursive=True)
    }
    if not helpers:
        return None
    chosen = draws.choice(list(helpers))
    known[helpers[chosen].pid] = sizes[helpers[chosen]]
    return chosen


def results(out: Path) -> dict[str, object]:
    """Return what a study measured and learned: bytes of every file, and curves without times."""
    patterns = (
        "checkpoints/*/*.safetensors",
        "evaluation/**/*.*",
        "evaluations.csv",
        "config.json",
    )
    found: dict[str, object] = {}
    for run in sorted(path.parent for path in out.glob("*/*/config.json")):
        for pattern in patterns:
            for path in run.glob(pattern):
                found[path.relative_to(out).as_posix()] = path.read_bytes()
        rows = read_csv(run / "metrics.csv")
        found[f"{run.relative_to(out)} metrics"] = [
            {name: value for name, value in row.items() if not name.endswith("_s")}
            for row in rows
        ]
    return found


def kill_study(
    kills: int,
    seed: int,
    experiments: tuple[str, ...] = (ALONE, HELPED),
    victims: tuple[str, ...] = ("worker", "driver", "helper"),
) -> tuple[int, list[str]]:
    """Kill processes of a study at random moments, and compare it with an undisturbed one.

    Args:
        kills: how often; the study has a training seed for six of them.
        seed: of moments and processes.
        experiments: `HELPED`, the one with helper processes, among them.
        victims: kinds of processes that are killed in turn.

    Returns:
        The number of kills, and what differed or stayed behind.
    """
    draws = random.Random(seed)
    kinds = [victims[i % len(victims)] for i in range(kills)]
    draws.shuffle(kinds)
    mark, shared = uuid.uuid4().hex, _shared_memory()
    killed, known, failures = 0, {}, []
    with tempfile.TemporaryDirectory() as folder:
        study, disturbed, calm = (
            Path(folder) / name for name in ("s.toml", "disturbed", "calm")
        )
        seeds = list(range(-(-kills // 6)))
        text = STUDY.replace("EXPERIMENTS", str(list(experiments)))
        study.write_text(text.replace("SEEDS", str(seeds)))
        driver = _start(study, disturbed, mark)
        while kinds and driver.poll() is None:
            time.sleep(draws.uniform(0.3, 3))
            try:
                chosen = _victim(kinds[-1], driver.pid, disturbed, known, draws)
                if chosen is None:
                    kinds.insert(0, kinds.pop())  # there is none at this moment
                    continue
                chosen.kill()
            except psutil.NoSuchProcess:
                continue
            killed += 1
            if kinds.pop() == "driver":
                driver.wait()
                driver = _start(study, disturbed, mark)
        if kinds:
            failures.append(f"the study ended after {killed} of {kills} kills")
        if driver.wait() != 0:
            states = study_status(open_study(disturbed), disturbed)
            failures.append(f"the study failed: {[each.detail for each in states]}")
        if {each.state for each in study_status(open_study(disturbed), disturbed)} != {
            "done"
        }:
            failures.append("the study is not done")
        else:
            with (
                pytest.MonkeyPatch.context() as patch
            ):  # in this process, without a worker
                patch.setattr(driver_module, "make_executor", InlineExecutor)
                run_study(open_study(disturbed), calm)
            wanted, found = results(calm), results(disturbed)
            failures += [
                f"{name} differs" for name in wanted if wanted[name] != found.get(name)
            ]
            failures += [
                f"{name} is left over" for name in found.keys() - wanted.keys()
            ]
    end = time.monotonic() + GONE_S
    while (_alive(mark) or _shared_memory() - shared) and time.monotonic() < end:
        time.sleep(0.2)
    failures += [f"process {process.pid} lives on" for process in _alive(mark)]
    failures += [f"/dev/shm/{name} is left over" for name in _shared_memory() - shared]
    return killed, failures
