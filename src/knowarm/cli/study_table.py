"""Live table of a study's runs: cells and seeds on a terminal, plain lines elsewhere."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from knowarm.cli.tables import lay_out, make_console
from knowarm.study.config import StudyConfig
from knowarm.study.driver import OnStatus
from knowarm.study.executor import RunKey
from knowarm.study.status import RunStatus, seconds_left, totals

EVERY_S = 60.0  # time between two plain lines without a change
STYLES = {"running": "cyan", "failed": "red", "stalled": "yellow", "done": "green"}


@contextmanager
def study_progress(study: StudyConfig) -> Iterator[OnStatus]:
    """Display a running study: as a table on a terminal, else as a line per change."""
    console = Console(highlight=False)
    if console.is_terminal:
        with Live(console=console, auto_refresh=False) as live:
            yield lambda statuses: live.update(
                Group(*status_tables(study, statuses, console.width)), refresh=True
            )
        return
    states: dict[RunKey, str] = {}
    last_line = -EVERY_S

    def show(statuses: Sequence[RunStatus]) -> None:
        nonlocal last_line
        changed = [each for each in statuses if states.get(each.run) != each.state]
        for each in changed:
            if each.run in states or each.state != "waiting":
                detail = f": {each.detail}" if each.detail else ""
                print(f"{each.name} {each.state}{detail}", flush=True)
        states.update({each.run: each.state for each in statuses})
        if changed or time.monotonic() - last_line >= EVERY_S:
            last_line = time.monotonic()
            print(summary_line(study, statuses), flush=True)

    yield show


def print_status(study: StudyConfig, statuses: Sequence[RunStatus]) -> None:
    """Print the status of all runs."""
    console = make_console()
    for table in status_tables(study, statuses, console.width):
        console.print(table, crop=False, soft_wrap=isinstance(table, Text))


def status_tables(
    study: StudyConfig, statuses: Sequence[RunStatus], room: int
) -> list[Table | Text]:
    """Return title, table and summary: one row per experiment and one column per seed."""
    left = seconds_left(statuses)
    found = {each.run: each for each in statuses}
    seeds = study.seeds
    rows = [[Text(cell), *(_cell(found[cell, s], left) for s in seeds)] for cell in study.cells()]
    tables = lay_out(["experiment", *(f"seed {seed}" for seed in study.seeds)], rows, room)
    title = Text(f"Study {study.name}", style="bold")
    return [title, *tables, Text(summary_line(study, statuses))]


def _cell(status: RunStatus, left: dict[RunKey, float]) -> Text:
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
    return Text(" · ".join(words), style=STYLES.get(status.state, ""))


def summary_line(study: StudyConfig, statuses: Sequence[RunStatus]) -> str:
    """Return the number of runs per state, and the cost so far and to go."""
    counts, spent, to_go = totals(statuses, study.where.cores).values()
    states = ", ".join(f"{count} {state}" for state, count in counts.items())
    rest = "" if to_go is None else f", {to_go:.2f} to go"
    return f"{len(statuses)} runs: {states}. Core hours of training: {spent:.2f}{rest}."
