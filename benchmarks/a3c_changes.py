"""Which changes make the paper's A3C learn: interim success with some groups of changed settings.

python -m benchmarks.a3c_changes add --steps 2000000
python -m benchmarks.a3c_changes leave-out --steps 5000000 --seeds 0
python -m benchmarks.a3c_changes set --groups thresholds rewards --steps 5000000
python -m benchmarks.a3c_changes pack --out docs/results/a3c-changes

"add" makes each change alone, to the settings of the study `a3c`; "leave-out" makes all but one,
which all together are `a3c-tuned`; "set" makes those that are named. Runs that exist are resumed,
those that are done are kept. "pack" writes one pack per set of changes and number of steps.

The smallest set, by a rule fixed before these runs: leave out, with seed 0, one change after the
other. Changes without which the success is at least four fifths of that of all changes are dropped
together. If three seeds of the rest have four fifths of the success of three seeds of all changes,
the rest is enough; otherwise the dropped change whose absence cost most comes back, and so on.
"""

import argparse
import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from knowarm.cli.tables import print_table
from knowarm.config import to_dict
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.csv_log import read_csv
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run import run_path, train
from knowarm.experiment.run_folder import RunFolder
from knowarm.study.config import StudyConfig, read_study, write_study
from knowarm.study.pack import SUFFIX, pack_study
from knowarm.study.status import is_trained

EXPERIMENT = "irb120-full-a3c"

GROUPS = {
    "batch": ("envs_per_worker", "rollout_steps"),
    "bootstrap": ("bootstrap_at_time_limit",),
    "learning-rate": ("learning_rate", "learning_rate_schedule"),
    "epsilon": ("rmsprop_eps",),
    "discount": ("gamma", "gae_lambda"),
    "value-weight": ("vf_coef",),
    "entropy": ("ent_coef",),
    "rewards": ("reward_scale", "max_grad_norm"),
    "thresholds": ("threshold_factor", "threshold_decrease"),
    "pixels": ("pixel_shift", "pixel_scale"),
    "activation": ("fc_activation",),
}
"""Settings in which `a3c-tuned` differs from the study `a3c`, by the name of a change."""

EVALUATIONS = 4
"""Last of 20 interim evaluations whose mean is reported, and twentieths of the training's log."""


def settings(config: ExperimentConfig) -> dict[str, Any]:
    """Return the settings of algorithm and policy by name."""
    return {**to_dict(config.algorithm), **to_dict(config.policy)}


def published() -> ExperimentConfig:
    """Return the settings of the study `a3c`: the paper's, with two batched workers."""
    return read_study("a3c").run(EXPERIMENT, 0)


def tuned() -> ExperimentConfig:
    """Return the settings that learn."""
    return experiment_config(f"{EXPERIMENT}-tuned")


def differences() -> dict[str, Any]:
    """Return the settings of `tuned` that differ from those of `published`."""
    before = settings(published())
    return {
        name: value
        for name, value in settings(tuned()).items()
        if value != before[name]
    }


def study_of(name: str, steps: int, seeds: Sequence[int]) -> StudyConfig:
    """Return the study of one set of changes: settings of `published`, some as in `tuned`."""
    study, values = read_study("a3c"), settings(tuned())
    fields = {
        field: values[field] for group in groups_of(name) for field in GROUPS[group]
    }
    policy = {
        field: v for field, v in fields.items() if hasattr(published().policy, field)
    }
    algorithm = {field: v for field, v in fields.items() if field not in policy}
    interim = {"every_steps": steps // 20}
    parts = {"policy": policy, "algorithm": algorithm, "interim": interim}
    return replace(
        study,
        name=f"a3c-{steps}-{name}",
        about=f"the study a3c with changes ({name}) and {steps:,} steps",
        experiments=(EXPERIMENT,),
        seeds=tuple(seeds),
        overrides={
            "total_steps": steps,
            **{
                part: {**study.overrides.get(part, {}), **each}
                for part, each in parts.items()
            },
        },
        evaluations=(),
    )


def trained(config: ExperimentConfig, out: Path) -> RunFolder:
    """Train, or resume and finish a training, unless it is done; return its folder."""
    folder = RunFolder(run_path(out, config))
    if not (folder.config_path.exists() and is_trained(folder, config)):
        train(config, out, resume=folder.path.exists())
    return folder


def outcome(folder: RunFolder) -> dict[str, Any]:
    """Return the means of the last interim evaluations, and of the training episodes near them."""
    evaluations = read_csv(folder.evaluations_path)[-EVALUATIONS:]
    log = read_csv(folder.metrics_path)
    first = float(log[-1]["step"]) * (1 - EVALUATIONS / 20)
    training = [row for row in log if float(row["step"]) > first]
    return {
        **{
            name: _mean(evaluations, name)
            for name in ("success", "accuracy", "return_mean")
        },
        **{
            f"training_{name}": _mean(training, name)
            for name in ("success", "return_mean")
        },
        "entropy": _mean(training, "entropy"),
    }


def _mean(rows: list[dict[str, str]], name: str) -> float:
    values = [float(row[name]) for row in rows if row.get(name)]
    return sum(values) / len(values) if values else math.nan


def name_of(groups: Collection[str]) -> str:
    """Return the name of a set of changes, whatever their order: what it has, or what it lacks."""
    named, missing = (
        [g for g in GROUPS if (g in groups) == there] for there in (True, False)
    )
    if len(named) > len(missing):
        return f"without-{'_'.join(missing)}" if missing else "all"
    return "_".join(named) or "none"


def groups_of(name: str) -> tuple[str, ...]:
    """Return the changes that `name_of` names.

    Raises `ValueError` for a name of no set of changes.
    """
    if name in ("all", "none"):
        return tuple(GROUPS) if name == "all" else ()
    named = name.removeprefix("without-").split("_")
    if not set(named) <= set(GROUPS):
        raise ValueError(
            f"no set of changes is named {name!r}; changes: {', '.join(GROUPS)}"
        )
    lacks = name.startswith("without-")
    return tuple(group for group in GROUPS if (group in named) != lacks)


def names_of(mode: str, groups: Collection[str]) -> list[str]:
    """Return the names of the sets of changes that a mode trains."""
    names = {
        "add": ["none", *GROUPS],
        "leave-out": ["all", *(f"without-{name}" for name in GROUPS)],
        "set": [name_of(groups)],
    }
    return names[mode]


def pack(runs: Path, out: Path) -> None:
    """Write one pack per set of changes and number of steps: ``<steps>-<name>.tar.xz``."""
    for folder in sorted(runs.glob("*/*")):
        steps, name = int(folder.parent.name), folder.name
        seeds = sorted(int(path.name) for path in (folder / EXPERIMENT).iterdir())
        study = study_of(name, steps, seeds)
        for config in study.runs():
            if not is_trained(RunFolder(run_path(folder, config)), config):
                raise SystemExit(
                    f"{run_path(folder, config)} is not done: finish or remove it."
                )
        write_study(study, folder)
        out.mkdir(parents=True, exist_ok=True)
        pack_study(folder, out / f"{steps}-{name}{SUFFIX}", leave_out=["policies"])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("mode", choices=("add", "leave-out", "set", "pack"))
    parser.add_argument("--groups", nargs="+", choices=GROUPS, default=[])
    parser.add_argument("--steps", type=int, default=2_000_000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--runs", type=Path, default=Path("runs/a3c-changes"))
    parser.add_argument("--out", type=Path, default=Path("docs/results/a3c-changes"))
    given = parser.parse_args()
    if given.mode == "pack":
        pack(given.runs, given.out)
        return
    rows: list[dict[str, Any]] = []
    for seed in given.seeds:
        for name in names_of(given.mode, given.groups):
            (config,) = study_of(name, given.steps, [seed]).runs()
            folder = trained(config, given.runs / str(given.steps) / name)
            rows.append({"change": name, "seed": seed, **outcome(folder)})
    print_table("A3C with changes", list(rows[0]), [list(row.values()) for row in rows])


if __name__ == "__main__":
    main()
