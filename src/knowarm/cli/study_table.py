"""Live table of a study's runs: cells and seeds on a terminal, plain lines elsewhere."""

import time
from collections.abc import Sequence

from rich.console import Console
from rich.live import Live
from rich.table import Table

from knowarm.study.config import StudyConfig
from knowarm.study.status import RunStatus, seconds_left, totals

EVERY_S = 60.0
"""Time between two plain lines without a change [s]."""

STYLES = {"running": "cyan", "failed": "red", "stalled": "yellow", "done": "green"}


class StudyProgress:
    """Display of a running study; use it as a context manager and call it with every status."""

    def __init__(self, study: StudyConfig) -> None:
        self._study = study
        self._console = Console(highlight=False)
        self._live: Live | None = None
        self._states: dict[object, str] = {}
        self._last_line = -EVERY_S

    def __enter__(self) -> "StudyProgress":
        """Start the display."""
        if self._console.is_terminal:
            self._live = Live(console=self._console, auto_refresh=False)
            self._live.start()
        return self

    def __exit__(self, *exception: object) -> None:
        """Leave the last table on the terminal."""
        if self._live is not None:
            self._live.stop()

    def __call__(self, statuses: Sequence[RunStatus]) -> None:
        """Show the status of all runs."""
        if self._live is not None:
            self._live.update(status_table(self._study, statuses), refresh=True)
            return
        changed = [each for each in statuses if self._states.get(each.run) != each.state]
        for each in changed:
            if self._states.get(each.run) or each.state != "waiting":
                detail = f": {each.detail}" if each.detail else ""
                print(f"{each.experiment}/{each.seed} {each.state}{detail}", flush=True)
        self._states = {each.run: each.state for each in statuses}
        if changed or time.monotonic() - self._last_line >= EVERY_S:
            self._last_line = time.monotonic()
            print(summary_line(self._study, statuses), flush=True)


def status_table(study: StudyConfig, statuses: Sequence[RunStatus]) -> Table:
    """Return one row per experiment and one column per seed."""
    table = Table(
        title=f"Study {study.name}", caption=summary_line(study, statuses), title_justify="left"
    )
    table.add_column("experiment", overflow="fold")
    for seed in study.seeds:
        table.add_column(f"seed {seed}", overflow="fold")
    left = seconds_left(statuses)
    for cell in study.cells():
        runs = {each.seed: each for each in statuses if each.experiment == cell}
        table.add_row(cell, *(_cell(runs[seed], left) for seed in study.seeds))
    return table


def _cell(status: RunStatus, left: dict[tuple[str, int], float]) -> str:
    words: list[str] = [status.state]
    if status.state not in ("waiting", "done", "trained"):
        words.append(f"{100 * status.step / status.total_steps:.0f} %")
    if status.success is not None:
        words.append(f"success {100 * status.success:.0f} %")
    if status.state == "running":
        if status.steps_per_s:
            words.append(f"{status.steps_per_s:,.0f}/s")
        if status.run in left:
            words.append(f"{left[status.run] / 60:.0f} min left")
    style = STYLES.get(status.state)
    text = " · ".join(words)
    return f"[{style}]{text}[/]" if style else text


def summary_line(study: StudyConfig, statuses: Sequence[RunStatus]) -> str:
    """Return the number of runs per state, and the cost so far and to go."""
    numbers = totals(statuses, study.where.cores)
    states = ", ".join(f"{count} {state}" for state, count in numbers["states"].items())
    to_go = numbers["core_hours_left"]
    rest = "" if to_go is None else f", {to_go:.2f} to go"
    spent = f"{numbers['core_hours']:.2f}"
    return f"{len(statuses)} runs: {states}. Core hours of training: {spent}{rest}."
