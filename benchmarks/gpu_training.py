"""Adding a training run to the result of `knowarm bench gpu`; `gpu.sh` calls it.

python benchmarks/gpu_training.py RUN --json gpu.json --times FILE
"""

import argparse
from pathlib import Path
from typing import Any

from knowarm.cli.bench import print_gpu
from knowarm.errors import UserError
from knowarm.experiment.run_folder import RunFolder, read_csv, read_json, write_json

WHOLE_RUN = 70_000_000
"""Environment steps of the paper's trainings."""

LEVEL = 0.8
"""Success rate of an interim evaluation whose first step is reported."""


def add_training(result: dict[str, Any], folder: RunFolder, seconds: float) -> dict[str, Any]:
    """Add a run to a result of ``bench_gpu``.

    Args:
        result: the result; may be empty.
        folder: the run.
        seconds: total wall time of the commands that trained it [s].

    Returns:
        The result with ``training``, see ``describe_training``, and ``training_minutes_70m``: the
        minutes of a finished run of 70 million steps, None for any other run.
    """
    training = describe_training(folder, seconds)
    whole = training["finished"] and training["total_steps"] == WHOLE_RUN
    minutes = training["minutes"] if whole else None
    return result | {"training": training, "training_minutes_70m": minutes}


def describe_training(folder: RunFolder, seconds: float) -> dict[str, Any]:
    """Describe a run.

    Args:
        folder: the run.
        seconds: wall time of the run so far [s].

    Returns:
        ``experiment``, ``algorithm``, ``total_steps`` of the config, ``step`` reached,
        ``finished``, ``minutes``, ``steps_per_s``, number of interim ``evaluations``, their
        ``best_success``, and ``step_at_80``, the first step with a success rate of at least 80 %
        (None if there is none).

    Raises:
        UserError: the run has no metrics yet.
    """
    config = folder.config()
    metrics, evaluations = (
        read_csv(path) if path.is_file() else []
        for path in (folder.metrics_path, folder.evaluations_path)
    )
    if not metrics:
        raise UserError(f"{folder.path} has no metrics yet; train it for longer.")
    step = int(float(metrics[-1]["step"]))
    success = [(int(float(row["step"])), float(row["success"])) for row in evaluations]
    return {
        "experiment": config["name"],
        "algorithm": config["algorithm"],
        "total_steps": config["total_steps"],
        "step": step,
        "finished": step >= config["total_steps"],
        "minutes": seconds / 60,
        "steps_per_s": step / seconds,
        "evaluations": len(evaluations),
        "best_success": max((share for _, share in success), default=None),
        "step_at_80": next((at for at, share in success if share >= LEVEL), None),
    }


def training_seconds(path: Path) -> float:
    """Sum the times of the commands that trained a run.

    Args:
        path: file with one line "begin end" per command, times of the clock [s].

    Raises:
        UserError: the file is missing or has another content.
    """
    try:
        lines = [[float(word) for word in line.split()] for line in path.read_text().splitlines()]
    except (OSError, ValueError) as error:
        raise UserError(f"Cannot read the times in {path}: {error}.") from error
    if not lines or any(len(line) != 2 for line in lines):
        raise UserError(f"{path} must hold lines of two times, begin and end of a command [s].")
    return sum(end - begin for begin, end in lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path, help="run folder")
    parser.add_argument("--json", type=Path, required=True, help="result of knowarm bench gpu")
    parser.add_argument("--times", type=Path, required=True, help="file of begin and end times")
    options = parser.parse_args()
    folder = RunFolder.open(options.run)
    result = add_training(read_json(options.json), folder, training_seconds(options.times))
    write_json(options.json, result)
    print_gpu(result)


if __name__ == "__main__":
    main()
