"""``knowarm benchmark``: score any policy on frozen episodes, verify rows, make a leaderboard."""

import sys
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from knowarm.benchmark.leaderboard import left_out, read_rows, write_leaderboard
from knowarm.benchmark.policies import entrant, is_safe
from knowarm.benchmark.rows import read_row, run_suite, verify
from knowarm.benchmark.suites import read_suite, suite_names
from knowarm.cli.tables import check_output, print_table
from knowarm.config import at_least
from knowarm.errors import UserError
from knowarm.reading import write_json

Policies = Annotated[tuple[str, ...], tyro.conf.arg(metavar="POLICY...")]

REFERENCES = ("oracle", "open-loop", "chance")
"""Scores of a suite that stand beside its cells."""

_report = partial(print, file=sys.stderr, flush=True)


@dataclass(frozen=True, kw_only=True)
class ShowSuites:
    """Show the suites, their cells and reference scores."""

    def run(self) -> None:
        """Print a table per suite."""
        titles = ["cell", "episodes", "success within"]
        titles += [f"{name} %" for name in REFERENCES]
        for suite in map(read_suite, suite_names()):
            rows = []
            for cell in suite.cells.values():
                env = cell.env
                within = f"{100 * env.success_distance_m:g} cm, {env.success_angle_deg:g} deg"
                scores = [_percent(cell.reference[name]) for name in REFERENCES]
                rows.append([cell.name, f"{len(cell.episodes):,}", within, *scores])
            print_table(f"{suite.name}: {suite.about}", titles, rows)
            print(
                f"Digest {suite.digest[:16]}; {suite.training_seeds} training seeds per row.\n"
            )


@dataclass(frozen=True, kw_only=True)
class RunSuite:
    """Play a suite with a policy and its controls, and write a row."""

    suite: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SUITE")]
    """Name of a suite: see `knowarm benchmark show`."""
    policy: Policies
    """Run folders of the training seeds of one agent, seen:RUN, a folder of `knowarm export`, ONNX
    files, ws://HOST:PORT, package.module:Name, package.module:Name:FILE, or a scripted agent. All
    but run folders and scripted agents must come from people whose code you would run."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("row.json")
    """File of the row."""
    name: str | None = None
    """Name of the row. Default: the policy."""
    cells: tuple[str, ...] = ()
    """Cells, or beginnings of their names, such as irb120. Default: all."""
    trial: int | None = None
    """Play only the first episodes of each cell, this many, print the figures and write no row."""

    def run(self) -> None:
        """Play, print and write."""
        if not self.policy:
            raise UserError(
                "--policy needs a policy: a run folder, an ONNX file, module:Name."
            )
        name = self.name or self.policy[0]
        suite = read_suite(self.suite)
        if self.trial is None:
            check_output(self.out, "--out")  # before minutes of playing
        else:
            at_least(self, 1, "trial")
            cells = {}
            for key, cell in suite.cells.items():
                cells[key] = replace(cell, episodes=cell.episodes[: self.trial])
            suite = replace(suite, cells=cells)
        entrants = list(map(entrant, self.policy))
        row = run_suite(suite, entrants, name=name, cells=self.cells, report=_report)
        titles = ["cell", "controls %", "success %", "right %"]
        for table, summary in row["summary"].items():
            rows = [[cell, *_figures(row["cells"][cell])] for cell in summary["cells"]]
            print_table(f"{name}: {table}", titles, rows)
        if self.trial is not None:
            print("A trial: no row was written.")
            return
        write_json(self.out, row)
        print(f"Wrote {self.out}")


@dataclass(frozen=True, kw_only=True)
class VerifyRow:
    """Check the figures of a row, play it again and compare every episode."""

    row: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="ROW")]
    """File of a row."""
    policy: Policies = ()
    """Where the policies are on this machine. Default: as in the row, if that names run folders or
    scripted agents."""
    tolerance: float = 0.0
    """Largest share of the episodes of a cell that may end otherwise, below .1, for a machine that
    rounds differently."""
    play: bool = True
    """Play again; otherwise only check that every figure follows from the stored episodes."""

    def run(self) -> None:
        """Check and say so."""
        row = read_row(self.row)
        if self.tolerance and not self.play:
            raise UserError("--no-play compares no episodes: leave out --tolerance.")
        how = "consistent; not played again"
        if self.play:
            specs = self.policy or row["policy"]["specs"]
            for spec in specs:
                if not self.policy and not is_safe(spec):
                    raise UserError(
                        f"{self.row} names code, a server or a model ({spec}), which a row of "
                        f"somebody else must not choose: give it yourself, --policy {spec}, or "
                        "use --no-play."
                    )
            entrants = list(map(entrant, specs))
            verify(row, entrants, tolerance=self.tolerance, report=_report)
            how = "played again with the same outcomes"
        print(f"{self.row}: {how}.")


@dataclass(frozen=True, kw_only=True)
class WriteTable:
    """Write a leaderboard, as HTML and as Markdown, from a folder of rows."""

    rows: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """Folder of rows."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("leaderboard.html")
    """File of the page."""

    def run(self) -> None:
        """Write and print the paths."""
        rows = read_rows(self.rows)
        for path in write_leaderboard(rows, self.out):
            print(f"Wrote {path}")
        for reason in left_out(rows):
            print(f"Left out: {reason}.")


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}"


def _figures(cell: dict[str, Any]) -> list[str]:
    """Return the cells of a table for the controls, success and right choices."""
    controls = [f"{name} {_percent(share)}" for name, share in cell["controls"].items()]
    success = _interval(cell["success"])
    return [", ".join(controls), success, _interval(cell.get("right"))]


def _interval(figures: dict[str, float] | None) -> str:
    if figures is None:
        return "-"
    mean = _percent(figures["mean"])
    return f"{mean} [{_percent(figures['low'])}, {_percent(figures['high'])}]"


COMMANDS = {
    "show": ShowSuites,
    "run": RunSuite,
    "verify": VerifyRow,
    "table": WriteTable,
}
"""Commands of the group `knowarm benchmark`, by name."""
