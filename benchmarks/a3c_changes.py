"""Which changes make the paper's A3C learn: interim success with some groups of changed settings.

python -m benchmarks.a3c_changes add --steps 2000000 --csv runs/a3c-changes/add.csv
python -m benchmarks.a3c_changes leave-out --steps 5000000 --csv runs/a3c-changes/leave-out.csv
python -m benchmarks.a3c_changes set --groups thresholds rewards --steps 5000000

"add" makes each change alone, to the settings of the study `a3c`; "leave-out" makes all but one,
which all together are `a3c-tuned`; "set" makes those that are named. Runs that exist are resumed,
rows that the CSV file has are kept.

The smallest set, by a rule fixed before these runs: leave out, with seed 0, one change after the
other. Changes without which the success is at least four fifths of that of all changes are dropped
together. If three seeds of the rest have four fifths of the success of three seeds of all changes,
the rest is enough; otherwise the dropped change whose absence cost most comes back, and so on.
"""

import argparse
import csv
import math
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

from knowarm.cli.tables import print_table
from knowarm.config import to_dict
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.csv_log import read_csv
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run import train
from knowarm.experiment.run_folder import RunFolder
from knowarm.study.config import read_study

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
    return read_study("a3c").run("irb120-full-a3c", 0)


def tuned() -> ExperimentConfig:
    """Return the settings that learn."""
    return experiment_config("irb120-full-a3c-tuned")


def differences() -> dict[str, Any]:
    """Return the settings of `tuned` that differ from those of `published`."""
    before = settings(published())
    return {name: value for name, value in settings(tuned()).items() if value != before[name]}


def changed(groups: tuple[str, ...], steps: int, seed: int) -> ExperimentConfig:
    """Return the settings of `published` with those of some groups as in `tuned`."""
    config, values = published(), settings(tuned())
    fields = {name: values[name] for group in groups for name in GROUPS[group]}
    parts = {
        part: replace(
            getattr(config, part),
            **{name: v for name, v in fields.items() if hasattr(getattr(config, part), name)},
        )
        for part in ("algorithm", "policy")
    }
    interim = replace(config.interim, every_steps=steps // 20)
    return replace(config, **parts, interim=interim, total_steps=steps, seed=seed)


def measure(config: ExperimentConfig, runs: Path) -> dict[str, Any]:
    """Train, or resume and finish a training; return its last interim evaluations."""
    path = runs / config.name / str(config.seed)
    run = train(config, runs, resume=path.exists())
    return outcome(run.folder)


def outcome(folder: RunFolder) -> dict[str, Any]:
    """Return the means of the last interim evaluations, and of the training episodes near them."""
    evaluations = read_csv(folder.evaluations_path)[-EVALUATIONS:]
    log = read_csv(folder.metrics_path)
    first = float(log[-1]["step"]) * (1 - EVALUATIONS / 20)
    training = [row for row in log if float(row["step"]) > first]
    return {
        **{name: _mean(evaluations, name) for name in ("success", "accuracy", "return_mean")},
        **{f"training_{name}": _mean(training, name) for name in ("success", "return_mean")},
        "entropy": _mean(training, "entropy"),
    }


def _mean(rows: list[dict[str, str]], name: str) -> float:
    values = [float(row[name]) for row in rows if row.get(name)]
    return sum(values) / len(values) if values else math.nan


def name_of(groups: Collection[str]) -> str:
    """Return the name of a set of changes, whatever their order."""
    missing = [name for name in GROUPS if name not in groups]
    if len(missing) < 2:
        return f"without-{missing[0]}" if missing else "all"
    return "+".join(name for name in GROUPS if name in groups) or "none"


def groups_of(name: str) -> tuple[str, ...]:
    """Return the changes that `name_of` names.

    Raises `ValueError` for a name of no set of changes.
    """
    every = tuple(GROUPS)
    left_out = {"all": every, "none": ()}
    left_out |= {f"without-{one}": tuple(g for g in every if g != one) for one in every}
    groups = left_out.get(name, tuple(name.split("+")))
    if not set(groups) <= set(every):
        raise ValueError(f"no set of changes is named {name!r}; changes: {', '.join(every)}")
    return groups


def variants(mode: str, groups: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Return the groups to change by the name of the variant."""
    names = {
        "add": ["none", *GROUPS],
        "leave-out": ["all", *(f"without-{name}" for name in GROUPS)],
        "set": [name_of(groups)],
    }
    return {name: groups_of(name) for name in names[mode]}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("mode", choices=("add", "leave-out", "set"))
    parser.add_argument("--groups", nargs="+", choices=GROUPS, default=[])
    parser.add_argument("--steps", type=int, default=2_000_000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--runs", type=Path, default=Path("runs/a3c-changes"))
    parser.add_argument("--csv", type=Path)
    given = parser.parse_args()
    rows: list[dict[str, Any]] = []
    if given.csv is not None and given.csv.exists():
        rows = list(csv.DictReader(given.csv.read_text(encoding="utf-8").splitlines()))
    done = {(row["change"], int(row["seed"]), int(row["steps"])) for row in rows}
    for seed in given.seeds:
        for name, groups in variants(given.mode, tuple(given.groups)).items():
            if (name, seed, given.steps) in done:
                continue
            config = changed(groups, given.steps, seed)
            result = measure(config, given.runs / str(given.steps) / name)
            rows.append({"change": name, "seed": seed, "steps": given.steps, **result})
            if given.csv is not None:
                given.csv.parent.mkdir(parents=True, exist_ok=True)
                with given.csv.open("w", newline="", encoding="utf-8") as file:
                    writer = csv.DictWriter(file, rows[0], lineterminator="\n")
                    writer.writeheader()
                    writer.writerows(rows)
    print_table("A3C with changes", list(rows[0]), [list(row.values()) for row in rows])


if __name__ == "__main__":
    main()
