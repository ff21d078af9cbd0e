"""`docs/results/a3c-changes.csv`: what each change from `a3c` to `a3c-tuned` reached."""

import csv
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.a3c_changes import outcome
from knowarm.experiment.run import run_path
from knowarm.experiment.run_folder import RunFolder
from knowarm.study.driver import open_study
from knowarm.study.pack import SUFFIX, unpack_study

MEASURES = ("success", "return_mean", "entropy")
# Measures of a variant by name, one number per training seed
Variant = dict[str, np.ndarray]


def read_variants(packs: Path) -> Iterator[tuple[int, str, Variant]]:
    """Yield steps, changes and what the runs reached of each pack of `benchmarks.a3c_changes`."""
    for file in sorted(packs.glob(f"*{SUFFIX}")):
        number, name = file.name.removesuffix(SUFFIX).split("-", 1)
        with tempfile.TemporaryDirectory() as temporary:
            study = unpack_study(file, Path(temporary) / name)
            configs = open_study(study).runs()
            folders = [RunFolder(run_path(study, config)) for config in configs]
            yield int(number), name, variant(folders)


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
