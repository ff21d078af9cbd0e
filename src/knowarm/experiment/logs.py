"""Training logs: CSV files, a copy for TensorBoard, and the progress display at the terminal."""

import math
import sys
import time
from collections.abc import Collection, Mapping
from contextlib import suppress
from importlib.util import find_spec
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from knowarm.experiment.csv_log import CsvLog, writing
from knowarm.experiment.run_folder import RunFolder
from knowarm.learn.trainer import Metrics

if TYPE_CHECKING:  # belongs to an extra
    from torch.utils.tensorboard import SummaryWriter

LINE_S = 10.0
"""Time between two plain lines [s]."""


class TrainingProgress:
    """Progress display of one training; use it as a context manager.

    On a terminal: a bar with rate, remaining time and success in the latest interim evaluation.
    Elsewhere: a plain line every `LINE_S` seconds. Episodes of the training itself are not shown:
    they may have easier thresholds, or start on the path of a teacher.
    """

    def __init__(self, label: str, total_steps: int):
        self._label = label
        self._total = total_steps
        self._console = Console(stderr=True)
        self._bar: Progress | None = None
        self._figures = ""
        self._start_time = time.monotonic()
        self._last_line_time = self._start_time
        self._first_step: int | None = None

    def __enter__(self) -> "TrainingProgress":
        """Start the display."""
        if self._console.is_terminal:
            self._bar = Progress(
                TextColumn("{task.description}", style="bold", markup=False),
                BarColumn(),
                TextColumn(
                    "{task.completed:,.0f}/{task.total:,.0f} {task.fields[rate]}"
                ),
                TimeRemainingColumn(),
                TextColumn("{task.fields[figures]}"),
                console=self._console,
            )
            self._task = self._bar.add_task(
                self._label, total=self._total, rate="", figures=""
            )
            self._bar.start()
        return self

    def __exit__(self, *exception: object) -> None:
        """Stop the display and restore the terminal."""
        if self._bar is not None:
            with suppress(OSError):  # the terminal has closed
                self._bar.stop()

    def metrics(self, row: Mapping[str, float]) -> None:
        """Display one row of training metrics; its ``step`` sets the bar."""
        step = int(row["step"])
        now = time.monotonic()
        if self._first_step is None:
            self._first_step = step
            self._start_time = now
        elapsed = now - self._start_time
        rate = 0.0
        if elapsed > 0:
            rate = (step - self._first_step) / elapsed
        speed = f"{rate:,.0f} steps/s" if rate else ""
        if self._bar is not None:
            self._bar.update(
                self._task, completed=step, rate=speed, figures=self._figures
            )
        elif now - self._last_line_time >= LINE_S:
            self._last_line_time = now
            left = max(self._total - step, 0)
            remaining = f"{left / rate / 60:.1f} min left" if rate else ""
            share = min(100 * step / self._total, 100)
            figures = (
                f"{step:,} steps ({share:.1f} %)",
                speed,
                remaining,
                self._figures,
            )
            self.line(", ".join(filter(None, figures)))

    def evaluation(
        self,
        step: int,
        results: Mapping[str, float],
        is_best: bool,
    ) -> None:
        """Print the result of an interim evaluation."""
        success = f"success {100 * results['success']:.0f} %"
        self._figures = f"{success} in the last evaluation"
        best = ", best so far" if is_best else ""
        self.line(
            f"evaluation at {step:,}: return {results['return_mean']:.1f}, {success}{best}"
        )

    def line(self, text: str) -> None:
        """Print a line above the bar, or to stderr without one."""
        line = f"{self._label}: {text}"
        with suppress(
            OSError
        ):  # the terminal has closed; training goes on, or saves and stops
            if self._bar is not None:
                self._bar.console.print(line, highlight=False, markup=False)
            else:
                print(line, file=sys.stderr, flush=True)


class RunLogs:
    """Writers of metrics and evaluations: CSV, the progress display and a copy for TensorBoard.

    The copy is written where TensorBoard is installed.
    """

    def __init__(self, folder: RunFolder, progress: TrainingProgress):
        self._folder = folder
        self._progress = progress

    def open(self, *, keep_to_step: int | None, pending: Collection[int] = ()) -> None:
        """Open the files; drop rows of later steps, and evaluations that will be played again."""
        self._metrics = CsvLog(self._folder.metrics_path, keep_to_step=keep_to_step)
        self._evaluations = CsvLog(
            self._folder.evaluations_path, keep_to_step=keep_to_step, drop_steps=pending
        )
        purge_step = None if keep_to_step is None else keep_to_step + 1
        self._tensorboard = self._open_tensorboard(purge_step)

    def metrics(self, row: Metrics) -> None:
        """Write one row of training metrics."""
        self._metrics.write(row)
        self._scalars("train", row)
        self._progress.metrics(row)

    def evaluation(self, step: int, results: Metrics, is_best: bool) -> None:
        """Write one interim evaluation."""
        self._evaluations.write({"step": step, **results, "best": int(is_best)})
        self._scalars("evaluation", {"step": step, **results})
        self._progress.evaluation(step, results, is_best)

    def close(self) -> None:
        """Flush TensorBoard's event file."""
        if self._tensorboard is not None:
            with writing(self._folder.tensorboard):
                self._tensorboard.close()

    def _open_tensorboard(self, purge_step: int | None) -> "SummaryWriter | None":
        if find_spec("tensorboard") is None:
            self._progress.line(
                "curves are written to CSV files only; for TensorBoard: "
                "pip install 'knowarm[tensorboard]'"
            )
            return None
        from torch.utils.tensorboard import SummaryWriter

        return SummaryWriter(str(self._folder.tensorboard), purge_step=purge_step)

    def _scalars(self, group: str, row: Metrics) -> None:
        if self._tensorboard is None:
            return
        with writing(self._folder.tensorboard):
            for name, value in row.items():
                if name != "step" and math.isfinite(value):
                    self._tensorboard.add_scalar(
                        f"{group}/{name}", value, int(row["step"])
                    )
