"""Runs with changes of A3C as files, without a training."""

from pathlib import Path

from benchmarks import a3c_changes
from knowarm.config import to_dict
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.run import run_path
from knowarm.experiment.run_folder import FORMAT, RunFolder
from knowarm.reading import write_json


def write_run(
    config: ExperimentConfig,
    out: Path,
    *,
    success: float = 0.5,
    step: int | None = None,
) -> None:
    """Write what a training leaves, which has taken all of its steps unless given.

    Its return is -70 minus the seed, its training took a minute.
    """
    folder = RunFolder(run_path(out, config))
    step = config.total_steps if step is None else step
    write_json(folder.config_path, {"format": FORMAT, **to_dict(config)})
    write_json(folder.checkpoints / "latest" / "meta.json", {"facts": {"step": step}})
    returns = -70 - config.seed
    row = f"{step},60,{success},{success},{returns},9.5\n"
    log = f"step,wall_time_s,success,accuracy,return_mean,entropy\n{row}"
    folder.metrics_path.write_text(log)
    folder.evaluations_path.write_text(log)


def write_runs(runs: Path, steps: int, successes: dict[str, list[float]]) -> None:
    """Write the runs of sets of changes, whose seeds have these successes."""
    for name, values in successes.items():
        study = a3c_changes.study_of(name, steps, range(len(values)))
        for config, success in zip(study.runs(), values, strict=True):
            write_run(config, runs / str(steps) / name, success=success)
