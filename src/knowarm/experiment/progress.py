"""Steps go in; a bar with rate and remaining time, or plain lines, come out."""

import sys
import time
from collections import deque
from collections.abc import Mapping

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

EPISODES_SHOWN = 500
"""Episodes that the shown return and success are means of, at least, once there are so many."""


class TrainingProgress:
    """Shows how a training goes; use it as a context manager.

    On a terminal: one bar with rate, remaining time and the latest figures. Elsewhere: a plain
    line every ``every_s`` seconds, so that logs stay short.
    """

    def __init__(self, label: str, total_steps: int, *, every_s: float = 10.0):
        self._label = label
        self._total = total_steps
        self._every_s = every_s
        self._console = Console(stderr=True)
        self._bar: Progress | None = None
        self._figures = ""
        self._episodes: deque[tuple[float, float, float]] = deque()
        self._began = self._said = time.monotonic()
        self._first_step: int | None = None

    def __enter__(self) -> "TrainingProgress":
        """Begin to show."""
        if self._console.is_terminal:
            self._bar = Progress(
                TextColumn("[bold]{task.description}"),
                BarColumn(),
                TextColumn("{task.completed:,.0f}/{task.total:,.0f}"),
                TextColumn("{task.fields[rate]}"),
                TimeRemainingColumn(),
                TextColumn("{task.fields[figures]}"),
                console=self._console,
            )
            self._task = self._bar.add_task(self._label, total=self._total, rate="", figures="")
            self._bar.start()
        return self

    def __exit__(self, *exception: object) -> None:
        """Leave the terminal as it was."""
        if self._bar is not None:
            self._bar.stop()

    def metrics(self, row: Mapping[str, float]) -> None:
        """Take one row of metrics; ``step`` moves the bar."""
        step = int(row["step"])
        now = time.monotonic()
        if self._first_step is None:
            self._first_step, self._began = step, now
        elapsed = now - self._began
        rate = (step - self._first_step) / elapsed if elapsed > 0 else 0.0
        if row.get("episodes"):
            self._remember(row["episodes"], row["return_mean"], row["success"])
        speed = f"{rate:,.0f} steps/s" if rate else ""
        if self._bar is not None:
            self._bar.update(self._task, completed=step, rate=speed, figures=self._figures)
        elif now - self._said >= self._every_s:
            self._said = now
            left = f", {(self._total - step) / rate / 60:.1f} min left" if rate else ""
            share = 100 * step / self._total
            self.say(f"{step:,} steps ({share:.1f} %), {speed}{left}, {self._figures}")

    def _remember(self, count: float, return_mean: float, success: float) -> None:
        """Average over the last episodes.

        One update's episodes will not do: where few of them end, they are the ones that
        succeeded early.
        """
        self._episodes.append((count, return_mean, success))
        while sum(entry[0] for entry in self._episodes) - self._episodes[0][0] >= EPISODES_SHOWN:
            self._episodes.popleft()
        total = sum(entry[0] for entry in self._episodes)
        mean = sum(entry[0] * entry[1] for entry in self._episodes) / total
        share = sum(entry[0] * entry[2] for entry in self._episodes) / total
        self._figures = f"return {mean:.1f} success {100 * share:.0f} %"

    def evaluation(self, step: int, results: Mapping[str, float], is_best: bool) -> None:
        """Say the result of an interim evaluation."""
        best = ", best so far" if is_best else ""
        self.say(
            f"evaluation at {step:,}: return {results['return_mean']:.1f}, "
            f"success {100 * results['success']:.0f} %{best}"
        )

    def say(self, text: str) -> None:
        """Print a line without breaking the bar."""
        if self._bar is not None:
            self._bar.console.print(f"{self._label}: {text}", highlight=False, markup=False)
        else:
            print(f"{self._label}: {text}", file=sys.stderr, flush=True)
