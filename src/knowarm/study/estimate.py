"""Cost of a study before it starts, from a short measurement of every experiment.

``python -m knowarm.study.estimate`` measures the experiment whose config it reads from its input.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from knowarm.config import from_dict, replace, to_dict
from knowarm.cores import limited_to
from knowarm.errors import UserError
from knowarm.experiment.blind import count_blind_episodes, prepare_blind_agents
from knowarm.experiment.build import load_agent
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.run import train
from knowarm.study.config import StudyConfig
from knowarm.study.driver import RUN_GIB
from knowarm.study.executors import EXECUTORS
from knowarm.study.status import study_status

SECONDS = 6.0
"""Measuring time of an experiment, after its first update [s]."""

NEVER = 10**12

EPISODES = 128
"""Episodes that are played to measure the evaluation; untrained policies need all of their steps,
so the estimate is an upper bound."""


@dataclass(frozen=True, kw_only=True)
class ExperimentCost:
    """Estimated cost of the runs of one experiment that are not done."""

    experiment: str
    runs: int
    steps_per_s: float
    core_hours: float


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Estimated cost of what is left of a study."""

    rows: Sequence[ExperimentCost]
    slots: int
    core_hours: float
    hours: float
    """With ``slots`` runs at once."""
    disk_gib: float


def estimate(study: StudyConfig, out: Path) -> Estimate:
    """Measure every experiment of a study, as many at once as would run, and add up the costs.

    Raises:
        UserError: the executor cannot run anything, or an experiment cannot be trained.
    """
    executor = EXECUTORS[study.where.kind].make(study.where, out)
    slots = executor.slots
    executor.close()
    statuses = [each for each in study_status(study, out) if each.state != "done"]
    configs = {each.experiment: study.run(*each.run) for each in statuses}
    searches = sum(each.blind_episodes > 0 for each in study.evaluations)

    def measured(config: ExperimentConfig) -> dict[str, float]:
        return measure(config, study.where.cores, search=searches > 0)

    with ThreadPoolExecutor(min(slots, os.cpu_count() or 1)) as pool:
        speeds = dict(zip(configs, pool.map(measured, configs.values()), strict=True))
    episodes = sum(each.episodes + count_blind_episodes(each) for each in study.evaluations)
    rows = []
    for name, speed in speeds.items():
        runs = [each for each in statuses if each.experiment == name]
        seconds = sum(
            speed["start_s"]
            + each.steps_left / speed["steps_per_s"]
            + episodes / speed["episodes_per_s"]
            for each in runs
        )
        seconds += searches * speed["search_s"]  # the next run finds the lists
        hours = seconds * study.where.cores / 3600
        rows.append(
            ExperimentCost(
                experiment=name,
                runs=len(runs),
                steps_per_s=speed["steps_per_s"],
                core_hours=hours,
            )
        )
    total = sum(row.core_hours for row in rows)
    waiting = sum(each.state == "waiting" for each in statuses)
    return Estimate(
        rows=rows,
        slots=slots,
        core_hours=total,
        hours=total / study.where.cores / slots,
        disk_gib=RUN_GIB * waiting,
    )


def measure(config: ExperimentConfig, cores: int, *, search: bool = False) -> dict[str, float]:
    """Measure an experiment in a process of its own.

    Args:
        config: the experiment.
        cores: of a run.
        search: whether blind agents are prepared.

    Returns:
        ``steps_per_s`` of training, ``episodes_per_s`` of evaluation, ``search_s`` of
        `prepare_blind_agents`, ``start_s`` of the process.

    Raises:
        UserError: it cannot be trained.
    """
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "knowarm.study.estimate", *(["search"] if search else [])],
        input=json.dumps(to_dict(config)),
        capture_output=True,
        text=True,
        env=os.environ | limited_to(cores),
    )
    if done.returncode:
        reason = done.stderr.strip().splitlines()[-1:]
        raise UserError(f"{config.name} cannot be trained: {' '.join(reason)}")
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    found["start_s"] = max(0.0, time.perf_counter() - begin - found.pop("busy_s"))
    return found


@dataclass
class _Clock:
    """Mirror that notes when each row of the training metrics arrives."""

    begin: float
    rows: list[tuple[float, int]] = field(default_factory=list)

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        if any(name.startswith("train/") for name in values):
            self.rows.append((time.perf_counter(), step))

    def close(self) -> None:
        pass

    def is_enough(self) -> bool:
        return len(self.rows) > 1 and self.rows[-1][0] - self.rows[0][0] > SECONDS

    def steps_per_s(self) -> float:
        """Return the rate without the first row, which compiles and fills caches."""
        first = self.rows[0] if len(self.rows) > 1 else (self.begin, 0)
        return (self.rows[-1][1] - first[1]) / (self.rows[-1][0] - first[0])


def _measure_here(config: ExperimentConfig, *, search: bool) -> dict[str, float]:
    """Train for a few seconds and evaluate once, in this process."""
    clock = _Clock(time.perf_counter())
    never: dict[str, Any] = {"checkpoint_every_steps": NEVER, "interim": {"every_steps": NEVER}}
    with tempfile.TemporaryDirectory() as folder:
        config = replace(config, never)
        run = train(config, folder, should_stop=clock.is_enough, mirrors=[clock])
        trained, start = load_agent(run.folder.path, which="latest"), time.perf_counter()
        evaluate(trained, episodes=EPISODES, record_films=0, blind_episodes=0)
        evaluated = time.perf_counter()
        if search:
            prepare_blind_agents(config.env)
        end = time.perf_counter()
    return {
        "steps_per_s": clock.steps_per_s(),
        "episodes_per_s": EPISODES / (evaluated - start),
        "search_s": end - evaluated,
        "busy_s": end - clock.begin,
    }


if __name__ == "__main__":
    config = from_dict(ExperimentConfig, json.load(sys.stdin))
    print(json.dumps(_measure_here(config, search="search" in sys.argv)))
