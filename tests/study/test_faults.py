"""A study under `kill -9`: it ends complete, with the bytes of an undisturbed one."""

import os
import random
import subprocess
import sys
import time
import uuid
from pathlib import Path

import psutil
import pytest

from knowarm.experiment.run_folder import read_csv
from knowarm.study.driver import open_study
from knowarm.study.status import study_status

MARK = "KNOWARM_FAULT_TEST"
KILLS = 20
STUDY = """
name = "faults"
experiments = ["irb120-bm-ppo", "irb120-full-ppo"]
seeds = [0, 1, 2]

[overrides]
total_steps = 1200
checkpoint_every_steps = 60
interim = {every_steps = 300, episodes = 2}
algorithm = {num_envs = 4, rollout_steps = 5, minibatches = 2, processes = 1}

[[overrides_for]]  # helper processes
experiments = "irb120-full-ppo"
fields.total_steps = 6400
fields.checkpoint_every_steps = 300
fields.algorithm = {num_envs = 32, processes = 2}

[[evaluations]]
episodes = 3
blind_episodes = 0

[where]
kind = "local"
at_once = 2
retries = 100
"""


def start(study: Path, out: Path, mark: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "knowarm", "study", "run", str(study), "--out", str(out)],
        env={**os.environ, MARK: mark},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def alive(mark: str) -> list[psutil.Process]:
    """Return the processes that descend from a marked driver, whoever their parent is now."""
    found = []
    for process in psutil.process_iter():
        try:
            if process.environ().get(MARK) == mark and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
        except psutil.Error:
            continue
    return found


def shared_memory() -> set[str]:
    return {path.name for path in Path("/dev/shm").iterdir() if "plasma" not in path.name}


def victim(kind: str, driver: int, mark: str) -> psutil.Process | None:
    """Return a random process: the driver, a worker, or a helper of a worker."""
    if kind == "driver":
        return psutil.Process(driver)
    workers = psutil.Process(driver).children()
    if kind == "worker":
        return random.choice(workers) if workers else None
    helpers = [child for worker in workers for child in worker.children(recursive=True)]
    return random.choice(helpers) if helpers else None


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
            {name: value for name, value in row.items() if not name.endswith("_s")} for row in rows
        ]
    return found


@pytest.mark.slow(140)
@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="needs /proc and /dev/shm")
def test_twenty_kills_change_nothing(tmp_path):
    study = tmp_path / "study.toml"
    study.write_text(STUDY)
    mark, shared = uuid.uuid4().hex, shared_memory()
    disturbed, calm = tmp_path / "disturbed", tmp_path / "calm"
    kinds = ["worker"] * 9 + ["driver"] * 6 + ["helper"] * 5
    assert len(kinds) == KILLS
    random.shuffle(kinds)
    killed: list[str] = []
    driver = start(study, disturbed, mark)
    deadline = time.monotonic() + 900
    while kinds and time.monotonic() < deadline:
        time.sleep(random.uniform(0.5, 6))
        if driver.poll() is not None:
            break
        try:
            chosen = victim(kinds[-1], driver.pid, mark)
            if chosen is None:
                kinds.insert(0, kinds.pop())  # there is none at this moment
                continue
            chosen.kill()
        except psutil.NoSuchProcess:
            continue
        killed.append(kinds.pop())
        if killed[-1] == "driver":
            driver.wait()
            driver = start(study, disturbed, mark)
    assert len(killed) == KILLS, f"the study ended after {killed}"
    assert driver.wait(600) == 0, [
        each.detail for each in study_status(open_study(disturbed), disturbed)
    ]
    assert {each.state for each in study_status(open_study(disturbed), disturbed)} == {"done"}
    assert start(study, calm, mark).wait(600) == 0
    assert results(calm) == results(disturbed)
    end = time.monotonic() + 20
    while (alive(mark) or shared_memory() - shared) and time.monotonic() < end:
        time.sleep(0.2)
    assert alive(mark) == []
    assert shared_memory() <= shared
