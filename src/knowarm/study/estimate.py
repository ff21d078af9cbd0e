"""Cost of a study before it starts, from one short measurement of training.

``python -m knowarm.study.estimate`` measures the experiment whose config it reads from its input.
"""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from knowarm.config import from_dict, to_dict
from knowarm.cores import limited_to
from knowarm.errors import UserError
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.speed import measure_training
from knowarm.study.config import StudyConfig
from knowarm.study.driver import make_executor
from knowarm.study.status import RunStatus, study_status

RUN_GIB = 0.15
"""Disk space that a run of default length may take [GiB]."""
SECONDS = 6.0
"""Measuring time, after the first updates [s]."""


class Estimate(NamedTuple):
    """Estimated cost of what is left of a study."""

    statuses: list[RunStatus]  # of the runs that are not done
    slots: int  # runs at once
    steps: int  # environment steps of training to go
    evaluation_steps: int  # most steps of evaluations: every episode ends at its time limit
    steps_per_s: float  # of one run while all slots are busy
    core_hours: float  # as if all steps cost as much as those measured
    hours: float  # with ``slots`` runs at once
    disk_gib: float  # most that the runs take


def estimate(study: StudyConfig, out: Path) -> Estimate:
    """Measure the first experiment that is not done, in all slots at once, and add up the costs."""
    slots, cores = make_executor(study.where, out).slots, study.where.cores
    statuses = [each for each in study_status(study, out) if each.state != "done"]
    busy = max(1, min(slots, len(statuses)))
    rate = 1.0
    if statuses:
        with ThreadPoolExecutor(busy) as pool:
            configs = [study.run(*statuses[0].run)] * busy
            rates = list(pool.map(lambda config: measure(config, cores), configs))
        rate = sum(rates) / len(rates)
    episodes = sum(
        each.episodes + sum(p.count_further(each.episodes) for p in each.probes)
        for each in study.evaluations
    )
    steps = sum(each.steps_left for each in statuses)
    played = sum(episodes * study.run(*each.run).env.max_episode_steps for each in statuses)
    core_hours = cores * (steps + played) / rate / 3600
    return Estimate(
        statuses=statuses,
        slots=slots,
        steps=steps,
        evaluation_steps=played,
        steps_per_s=rate,
        core_hours=core_hours,
        hours=core_hours / cores / busy,
        disk_gib=RUN_GIB * sum(each.state == "waiting" for each in statuses),
    )


def measure(config: ExperimentConfig, cores: int) -> float:
    """Measure training on some cores, in a process of its own [steps/s]."""
    done = subprocess.run(
        [sys.executable, "-m", "knowarm.study.estimate", str(SECONDS)],
        input=json.dumps(to_dict(config)),
        capture_output=True,
        text=True,
        env=os.environ | limited_to(cores),
    )
    if done.returncode:
        reason = " ".join(done.stderr.strip().splitlines()[-1:])
        raise UserError(f"{config.name} cannot be trained: {reason}")
    return float(done.stdout.splitlines()[-1])


if __name__ == "__main__":
    print(measure_training(from_dict(ExperimentConfig, json.load(sys.stdin)), float(sys.argv[1])))
