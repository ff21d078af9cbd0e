"""Campaign of failing file operations: full disks, missing permissions, missing files."""

import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import torch

from knowarm.experiment.csv_log import CsvLog
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.run import train
from knowarm.experiment.run_folder import RunFolder
from knowarm.learn.checkpoint import Checkpoint, CheckpointStore, read_checkpoint
from knowarm.report import write_report
from tests.robustness.formats import outcome
from tests.tiny import short


class _Faults:
    """Lets one file operation below a folder fail, chosen by its number."""

    def __init__(self) -> None:
        self._active: tuple[str, int, OSError] | None = None
        self._count = 0
        sys.addaudithook(self._hook)

    @contextmanager
    def inject(self, folder: Path, number: int, error: OSError) -> Iterator[None]:
        """Let the operation ``number`` fail."""
        self._count, self._active = 0, (str(folder), number, error)
        try:
            yield
        finally:
            self._active = None

    def _hook(self, event: str, arguments: tuple) -> None:
        if self._active is None or event not in OPERATIONS:
            return
        folder, number, error = self._active
        if threading.current_thread() is threading.main_thread() and any(
            folder in str(argument) for argument in arguments[:2]
        ):
            self._count += 1
            if self._count == number:
                raise error


OPERATIONS = {"open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "shutil.rmtree"}
ERRORS = [OSError(28, "No space left on device"), OSError(5, "Input/output error")]
ERRORS += [
    PermissionError(13, "Permission denied"),
    FileNotFoundError(2, "No such file"),
]

_faults: _Faults | None = None


def inject_file_errors(tries: int, seed: int) -> tuple[int, list[str]]:
    """Let single file operations fail; what fails must say so, and what was stored stay whole."""
    global _faults
    _faults = _faults or _Faults()
    torch.set_num_threads(1)
    random, failures = np.random.default_rng(seed), []
    arrays = {"a": np.arange(100.0)}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        run = train(
            short(total_steps=40), folder / "runs", policy={"features": 8}
        ).folder
        store = CheckpointStore(folder / "checkpoints", {})
        store.save(Checkpoint(policy=arrays, facts={"step": 0}))

        def save(number: int) -> None:
            store.save(Checkpoint(policy=arrays, facts={"step": number}))

        def log(number: int) -> None:
            CsvLog(folder / "log.csv", keep_to_step=number).write(
                {"step": number, f"c{number}": 1}
            )

        def report(number: int) -> None:
            write_report([run.path], folder / "report" / "report.html")

        def evaluated(number: int) -> None:
            evaluate(run.path, episodes=2, probes=(), label="faults")

        def training(number: int) -> None:
            config = short(total_steps=20 * (4 + number))
            train(config, folder / "runs", resume=True, policy={"features": 8})

        actions = [(save, 8, 20), (log, 8, 6), (report, 1, 30), (evaluated, 1, 12)]
        actions += [(training, 1, 60)]
        weights = np.array([weight for _, weight, _ in actions], float)
        for number in range(tries):
            action, _, most = actions[
                random.choice(len(actions), p=weights / weights.sum())
            ]
            error = ERRORS[int(random.integers(len(ERRORS)))]
            with _faults.inject(folder, int(random.integers(1, most)), error):
                failed = outcome(partial(action, number))
            if failed is not None:
                failures.append(f"{action.__name__} {number}: {failed}")
            try:
                store.load()
                RunFolder.open(run.path).experiment()
                read_checkpoint(run.checkpoints / "latest")
            except Exception as caught:
                failures.append(f"after {action.__name__} {number}: {caught}")
    return tries, failures
