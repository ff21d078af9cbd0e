"""A run folder and the times it was trained for go in; what a whole run took comes out."""

from pathlib import Path
from typing import Any

from knowarm.errors import UserError
from knowarm.experiment.run_folder import RunFolder, read_csv

WHOLE_RUN = 70_000_000
"""Environment steps of the paper's trainings."""

LEVEL = 0.8
"""Success of an interim evaluation whose first reaching is noted."""


def add_training(result: dict[str, Any], folder: RunFolder, seconds: float) -> dict[str, Any]:
    """Add a run to a result of ``bench_gpu``.

    Args:
        result: the result; may be empty.
        folder: the run.
        seconds: wall time of the commands that trained it, from start to end, together [s].

    Returns:
        The result with ``training``, see ``describe_training``, and ``training_minutes_70m``, its
        minutes if it is whole and of 70 million steps, else None.
    """
    training = describe_training(folder, seconds)
    whole = training["finished"] and training["total_steps"] == WHOLE_RUN
    minutes = training["minutes"] if whole else None
    return result | {"training": training, "training_minutes_70m": minutes}


def describe_training(folder: RunFolder, seconds: float) -> dict[str, Any]:
    """Describe a run.

    Args:
        folder: the run.
        seconds: wall time it took so far [s].

    Returns:
        ``experiment``, ``total_steps`` asked for, ``step`` reached, ``finished``, ``minutes``,
        ``steps_per_s`` over them, number of interim ``evaluations``, ``best_success`` of these and
        ``step_at_80``, the first step at which four fifths succeeded, None for never.

    Raises:
        UserError: the run has not taken a step yet.
    """
    config = folder.config()
    metrics, evaluations = (
        read_csv(path) if path.is_file() else []
        for path in (folder.metrics_path, folder.evaluations_path)
    )
    if not metrics:
        raise UserError(f"{folder.path} has not trained yet; there is nothing to add.")
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
    """Add up the commands that trained a run.

    Args:
        path: a file of lines "begin end", seconds of the clock, one line a command.

    Raises:
        UserError: the file is missing or holds something else.
    """
    try:
        lines = [[float(word) for word in line.split()] for line in path.read_text().splitlines()]
    except (OSError, ValueError) as error:
        raise UserError(f"Cannot read the times in {path}: {error}.") from error
    if not lines or any(len(line) != 2 for line in lines):
        raise UserError(f"{path} must hold lines of two numbers, begin and end of a command [s].")
    return sum(end - begin for begin, end in lines)
