"""Short trainings with the network on the CPU and on a GPU: speed, wall time and what was learned.

python -m benchmarks.devices                 # about four minutes with a GPU
python -m benchmarks.devices --devices cpu --steps 20000
"""

import argparse
import tempfile
import time
from typing import Any

from knowarm.cli.tables import print_table
from knowarm.cores import available_cores, processor
from knowarm.experiment.csv_log import read_csv
from knowarm.experiment.run import train

ALGORITHMS = ("fast", "ppo")
EVALUATIONS = 4
"""Interim evaluations of a training, the last one at its end."""


def measure(algorithm: str, device: str, steps: int, seed: int) -> dict[str, Any]:
    """Train ``irb120-full`` for some steps, and return a row of the table.

    ``steps_per_s`` is the median over all updates. The seeds of both devices
    are equal, their bytes are not: sums are rounded differently.
    """
    with tempfile.TemporaryDirectory() as runs:
        start = time.perf_counter()
        folder = train(
            f"irb120-full-{algorithm}",
            runs,
            seed=seed,
            total_steps=steps,
            algorithm={"device": device},
            interim={"every_steps": max(1, steps // EVALUATIONS)},
        ).folder
        seconds = time.perf_counter() - start
        speeds = sorted(
            float(row["steps_per_s"]) for row in read_csv(folder.metrics_path)
        )
        evaluations = read_csv(folder.evaluations_path)
    return {
        "algorithm": algorithm,
        "device": device,
        "steps_per_s": speeds[len(speeds) // 2],
        "seconds": seconds,
        "return_mean": [float(row["return_mean"]) for row in evaluations],
        "success": [float(row["success"]) for row in evaluations],
    }


def main() -> None:
    """Measure all devices and print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", nargs="+", default=["cpu", "cuda"])
    parser.add_argument("--steps", type=int, default=300_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rows = [
        measure(algorithm, device, arguments.steps, arguments.seed)
        for algorithm in ALGORITHMS
        for device in arguments.devices
    ]
    if "cuda" in arguments.devices:
        import torch

        print(f"GPU: {torch.cuda.get_device_name(0)}")
    print_table(
        f"{available_cores()} cores of {processor()}, {arguments.steps:,} steps",
        ["algorithm", "network on", "steps/s", "wall time, s", "return", "success"],
        [
            [
                row["algorithm"],
                row["device"],
                f"{row['steps_per_s']:,.0f}",
                f"{row['seconds']:.0f}",
                " ".join(f"{value:.0f}" for value in row["return_mean"]),
                " ".join(f"{100 * value:.0f} %" for value in row["success"]),
            ]
            for row in rows
        ],
    )


if __name__ == "__main__":
    main()
