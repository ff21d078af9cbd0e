"""Section of `docs/results/answer.md` on which changes make the paper's A3C learn."""

import csv
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.a3c_changes import (
    EVALUATIONS,
    GROUPS,
    groups_of,
    names_of,
    outcome,
)
from knowarm.experiment.run import run_path
from knowarm.experiment.run_folder import RunFolder
from knowarm.statistics import holm, welch
from knowarm.study.driver import open_study
from knowarm.study.pack import SUFFIX, unpack_study
from scripts.answer_cells import FEWEST, SIGNIFICANT, percent, table

ENOUGH = 0.8
"""Share of the success of all changes that a set of changes must reach to be enough."""

MEASURES = ("success", "return_mean", "entropy")
# Measures of a variant by name, one number per training seed
Variant = dict[str, np.ndarray]

TEXT = f"""**Protocol.** IRB120, `full`, fixed colours, two workers; the settings of the study
`a3c` with changes towards `a3c-tuned`, which has all of them; {{runs}} runs. Success and return:
means of the last {EVALUATIONS} of 20 interim evaluations of 40 episodes (5 cm, 15 degrees).
Brackets: 95 % intervals over training seeds (bootstrap, too narrow for so few). A linear learning
rate falls to its end within the steps of a run. All runs: `a3c-changes.csv`."""


def read_variants(packs: Path) -> Iterator[tuple[int, str, Variant]]:
    """Yield steps, changes and what the runs reached of each pack of `benchmarks.a3c_changes`."""
    for file in sorted(packs.glob(f"*{SUFFIX}")):
        number, name = file.name.removesuffix(SUFFIX).split("-", 1)
        with tempfile.TemporaryDirectory() as temporary:
            study = unpack_study(file, Path(temporary) / name)
            configs = open_study(study).runs()
            folders = [RunFolder(run_path(study, config)) for config in configs]
            yield int(number), name, variant(folders)


def changes_section(packs: Path) -> list[str]:
    """Return the blocks of the section from the packs of `benchmarks.a3c_changes`."""
    found: dict[int, dict[str, Variant]] = {}
    runs = 0
    for steps, name, measures in read_variants(packs):
        found.setdefault(steps, {})[name] = measures
        runs += len(measures["success"])
    blocks = ["## Which changes A3C needs", TEXT.format(runs=runs), settings_list()]
    lines = []
    for steps, measured in sorted(found.items()):
        ordered = {name: measured[name] for name in sorted(measured, key=place)}
        sets = {
            name: runs
            for name, runs in ordered.items()
            if len(runs["success"]) >= FEWEST
        }
        if any(runs["success"].any() for runs in sets.values()):
            blocks += [f"### After {steps / 1e6:g} million steps", measures_table(sets)]
        lines += [
            each(ordered, steps) for each in (single_changes, left_out, smallest_set)
        ]
    return [*blocks, "\n".join(f"- {line}" for line in lines if line)]


def write_changes(packs: Path, path: Path) -> None:
    """Write what each run of the packs reached to a CSV file."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["steps", "changes", "run", *MEASURES])
        for steps, name, measures in read_variants(packs):
            for run in range(len(measures["success"])):
                numbers = [f"{measures[key][run]:.4g}" for key in MEASURES]
                writer.writerow([steps, name, run, *numbers])


def variant(folders: Sequence[RunFolder]) -> Variant:
    """Return what the runs of one set of changes reached."""
    outcomes = [outcome(folder) for folder in folders]
    return {key: np.array([each[key] for each in outcomes]) for key in MEASURES}


def place(name: str) -> tuple[int, int]:
    """Order sets of changes by size, those of one size as they were trained."""
    names = [*names_of("add", ()), *names_of("leave-out", ())]
    return len(groups_of(name)), names.index(name) if name in names else -1


def settings_list() -> str:
    """Say which settings each change sets."""
    listed = (
        f"`{name}` ({', '.join(map(code, fields))})" for name, fields in GROUPS.items()
    )
    return f"Changes ([values](../reference/algorithms.md#a3c)): {', '.join(listed)}."


def code(name: str) -> str:
    """Format a name."""
    return f"`{name}`"


def measures_table(measured: Mapping[str, Variant]) -> str:
    """Return what each variant reached."""
    rows = [
        [f"`{name}`", percent(runs["success"]), listed(runs["return_mean"])]
        for name, runs in measured.items()
    ]
    return table(["change", "success [%]", "return, each seed"], rows)


def listed(values: np.ndarray) -> str:
    """Format one number per training seed."""
    return ", ".join(f"{value:.1f}" for value in values)


def single_changes(measured: Mapping[str, Variant], steps: int) -> str:
    """Say which single changes move the return, by Welch's t tests with Holm's correction."""
    alone = [name for name in measured if name in GROUPS]
    if "none" not in measured or not alone:
        return ""
    base = measured["none"]["return_mean"]
    best = max(alone, key=lambda name: float(measured[name]["success"].mean()))
    most = 100 * measured[best]["success"].mean()
    found = (
        f"the most success has `{best}`, {most:.1f} %" if most else "none has a success"
    )
    text = f"After {steps / 1e6:g} million steps with one of {len(alone)} changes, {found}. "
    usable = [
        name for name in alone if min(len(base), len(measured[name]["success"])) >= 3
    ]
    if len(usable) < len(alone):
        return f"{text}Not every change has three seeds, so their returns are not compared."
    tests = [welch(measured[name]["return_mean"], base) for name in alone]
    decided = [
        (test.difference, name)
        for name, test, p in zip(
            alone, tests, holm([t.p_value for t in tests]), strict=True
        )
        if p < SIGNIFICANT
    ]
    higher, lower = (
        ", ".join(
            f"`{name}` ({each.estimate:+.0f} [{each.low:+.0f}, {each.high:+.0f}])"
            for each, name in decided
            if each.estimate * sign > 0
        )
        for sign in (1, -1)
    )
    return (
        f"{text}The return is significantly (Welch's t test, Holm) higher with "
        f"{higher or 'none of them'}, and lower with {lower or 'none of them'}."
    )


def left_out(measured: Mapping[str, Variant], steps: int) -> str:
    """Say which changes the search with one training seed kept, and which it dropped."""
    without = {
        name: float(measured[f"without-{name}"]["success"][0])
        for name in GROUPS
        if f"without-{name}" in measured
    }
    if "all" not in measured or not without:
        return ""
    level = ENOUGH * float(measured["all"]["success"][0])
    needed = [name for name, success in without.items() if success < level]
    dropped = [name for name in without if name not in needed]
    return (
        f"One change left out of all {len(GROUPS)} for {steps / 1e6:g} million steps, one training "
        f"seed: less than {100 * ENOUGH:.0f} % of the success of all without {quoted(needed)}, "
        f"and at least as much without {quoted(dropped)}. One seed is no result; it chose the "
        "sets of three seeds."
    )


def smallest_set(measured: Mapping[str, Variant], steps: int) -> str:
    """Say which set of changes with three seeds is the smallest that is enough."""
    tried = {
        name: each["success"]
        for name, each in measured.items()
        if len(each["success"]) >= 3
    }
    if "all" not in tried or len(tried) == 1:
        return ""
    level = ENOUGH * float(tried["all"].mean())
    enough = [name for name, success in tried.items() if success.mean() >= level]
    best = min(
        enough, key=lambda name: (len(groups_of(name)), -float(tried[name].mean()))
    )
    groups = groups_of(best)
    share = f"{100 * ENOUGH:.0f} % of the success of all {len(GROUPS)} changes"
    if best == "all":
        return (
            "No smaller set that three seeds tried for "
            f"{steps / 1e6:g} million steps has {share}."
        )
    missing = [name for name in GROUPS if name not in groups]
    which = (
        quoted(groups) if len(groups) < len(missing) else f"all but {quoted(missing)}"
    )
    return (
        f"After {steps / 1e6:g} million steps the smallest set that we found with {share} has "
        f"{len(groups)}: {which}. Sets that the table does not show were not tried."
    )


def quoted(names: Sequence[str]) -> str:
    """List names of changes."""
    return ", ".join(map(code, names)) or "none of them"
