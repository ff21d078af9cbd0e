"""Measures the training speed of the study `size`: networks of several sizes, in turns.

KNOWARM_CORES=1 python -m benchmarks.sizes --out docs/results/size-speed.csv
"""

import argparse
import csv
from pathlib import Path

from benchmarks.speed import measure_training
from knowarm.cores import processor
from knowarm.study.config import read_study


def main() -> None:
    """Measure and write a row per measurement."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=10)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    study = read_study("size")
    with given.out.open("w", encoding="utf-8", newline="") as file:
        log = csv.writer(file, lineterminator="\n")
        log.writerow(["processor", "agent", "steps_per_s"])
        for _ in range(given.rounds):
            for name in study.cells():
                config = study.run(name, study.seeds[0])
                speed = measure_training(config, given.seconds)
                log.writerow([processor(), config.agent, round(speed)])
                file.flush()


if __name__ == "__main__":
    main()
