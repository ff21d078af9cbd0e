"""Time of a study over that of its runs, divided by the number of runs at once.

python -m benchmarks.study_overhead --seconds 60
"""

import re
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from benchmarks.speed import measure_training
from knowarm.cli.tables import print_table
from knowarm.errors import UserError
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.experiment.names import DEFAULT_EXPERIMENT
from knowarm.experiment.probes import BlindProbe, StepsProbe
from knowarm.study.config import StudyConfig
from knowarm.study.driver import run_study
from knowarm.study.executor import LOG, LocalExecutor, Where
from knowarm.study.worker import WORKED

MEASURING_S = 6.0
"""Time of the training that tells how many steps a run takes [s]."""


@dataclass(frozen=True, kw_only=True)
class StudyBenchConfig:
    """Settings of the benchmark of studies."""

    seconds: float = 60.0
    """Approximate training time of each run [s]."""

    rounds: int = 2
    """Runs per slot."""

    def __post_init__(self) -> None:
        if self.rounds < 1 or not self.seconds > 0:
            raise UserError("rounds must be at least 1 and seconds above 0.")


def bench_study(config: StudyBenchConfig | None = None) -> dict[str, Any]:
    """Run a study of equal runs and compare its time with that of its runs.

    Returns:
        ``slots``, ``runs``, ``total_s`` of the study, ``runs_s`` (sum over all runs, each from the
        start of its process to its end) and ``overhead``: total over sum by slots.
    """
    config = config or StudyBenchConfig()
    where = Where()
    with tempfile.TemporaryDirectory() as folder:
        slots = LocalExecutor(where, Path(folder)).slots

        def study(steps: int) -> StudyConfig:
            return StudyConfig(
                name="bench",
                experiments=(DEFAULT_EXPERIMENT,),
                seeds=tuple(range(slots * config.rounds)),
                overrides={
                    "total_steps": steps,
                    "algorithm": {"processes": where.cores},
                },
                evaluations=(
                    EvaluationConfig(episodes=100, probes=(StepsProbe(), BlindProbe())),
                ),
                where=where,
            )

        rate = measure_training(study(10**9).runs()[0], MEASURING_S)
        chosen = study(int(rate * config.seconds))
        out, start = Path(folder) / "study", time.perf_counter()
        statuses = run_study(chosen, out)
        total = time.perf_counter() - start
        if failed := [each for each in statuses if each.state != "done"]:
            raise UserError(
                f"A run of the benchmark is {failed[0].state}: {failed[0].detail}"
            )
        logs = [
            (out / each.experiment / str(each.seed) / LOG).read_text()
            for each in statuses
        ]
    times = [float(re.findall(rf"{WORKED} ([\d.]+) s", log)[-1]) for log in logs]
    return {
        "where": where.kind,
        "slots": slots,
        "runs": len(times),
        "total_s": total,
        "runs_s": sum(times),
        "overhead": total / (sum(times) / slots),
    }


def main() -> None:
    result = bench_study(tyro.cli(StudyBenchConfig, description=__doc__))
    print_table("Study", list(result), [list(result.values())])


if __name__ == "__main__":
    main()
