"""Rows of metrics and evaluations go in; CSV, TensorBoard and the progress display get them."""

import math

from torch.utils.tensorboard import SummaryWriter

from knowarm.experiment.progress import TrainingProgress
from knowarm.experiment.run_folder import CsvLog, RunFolder
from knowarm.learn.trainer import Metrics


class RunLogs:
    """Everything that listens to one training.

    Args:
        folder: the run folder.
        progress: what the person at the terminal sees.
    """

    def __init__(self, folder: RunFolder, progress: TrainingProgress):
        self._folder = folder
        self._progress = progress

    def open(self, *, keep_to_step: int | None) -> None:
        """Begin to write; rows after ``keep_to_step`` of an earlier part of the run are dropped."""
        self._metrics = CsvLog(self._folder.metrics_path, keep_to_step=keep_to_step)
        self._evaluations = CsvLog(self._folder.evaluations_path, keep_to_step=keep_to_step)
        self._tensorboard = SummaryWriter(
            str(self._folder.tensorboard),
            purge_step=None if keep_to_step is None else keep_to_step + 1,
        )

    def metrics(self, row: Metrics) -> None:
        """Take one row of training metrics."""
        self._metrics.write(row)
        self._scalars("train", row)
        self._progress.metrics(row)

    def evaluation(self, step: int, results: Metrics, is_best: bool) -> None:
        """Take one interim evaluation."""
        self._evaluations.write({"step": step, **results, "best": int(is_best)})
        self._scalars("evaluation", {"step": step, **results})
        self._progress.evaluation(step, results, is_best)

    def close(self) -> None:
        """Flush what TensorBoard still holds."""
        self._tensorboard.close()

    def _scalars(self, group: str, row: Metrics) -> None:
        step = int(row["step"])
        for name, value in row.items():
            if name != "step" and math.isfinite(value):
                self._tensorboard.add_scalar(f"{group}/{name}", value, step)
