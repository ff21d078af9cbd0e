"""``knowarm benchmark``: score any policy on frozen episodes, verify rows, make a leaderboard."""

import shlex
import sys
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, arg

from knowarm.benchmark.freezing import EPISODES, freeze_cell, write_suite
from knowarm.benchmark.leaderboard import left_out, read_rows, write_leaderboard
from knowarm.benchmark.policies import entrant, is_safe
from knowarm.benchmark.rows import read_row, run_suite, verify
from knowarm.benchmark.suites import read_suite, suite_names
from knowarm.cli.tables import check_output, print_table
from knowarm.errors import UserError
from knowarm.experiment.evaluation import EvaluationConfig, SplitTest
from knowarm.knowledge.queries.splits import Split
from knowarm.reading import write_json
from knowarm.world.config import EnvConfig
from knowarm.world.tasks import find_task

Policies = Annotated[tuple[str, ...], arg(metavar="POLICY...")]

REFERENCES = ("oracle", "open-loop", "chance")
"""Scores of a suite that stand beside its cells."""


def _report(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


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
class FreezeSuite:
    """Freeze a suite of your own: draw episodes of a task, and store all that decides a score."""

    task: Annotated[Positional[str], arg(metavar="TASK")]
    """Name of a task, or package.module:Name of your own."""
    robot: Annotated[Positional[str], arg(metavar="ROBOT")]
    """Name of a robot, or the TOML file of your own."""
    to: Annotated[Path, arg(metavar="FOLDER")]
    """New folder of the suite."""
    targets: tuple[str, ...] = ()
    """Objects, names or TOML files. Default: the task's."""
    colours: Literal["fixed", "randomized"] = "fixed"
    """Always a target's first colour, or one of its colours drawn per episode."""
    graph: str | None = None
    """Graph of the questions: a file, or the name of a shipped one. Default: the task's."""
    splits: tuple[Split, ...] = ()
    """Splits of the questions, a cell each. Default: one cell, with those of training."""
    episodes: int = EPISODES
    """Episodes of each cell."""
    distance_m: float | None = None
    """Largest distance of a success [m]. Default: the robot's, or 5 cm."""
    angle_deg: float | None = None
    """Largest angle of a success [deg]. Default: the robot's, or 15."""
    training_seeds: int = 5
    """Training seeds that a complete row has."""
    control_episodes: int = 200
    """Episodes of each cell that the controls play."""

    def run(self) -> None:
        """Draw, play the references and write."""
        env = EnvConfig(
            robot=self.robot,
            task=find_task(self.task),
            targets=self.targets,
            colours=self.colours,
            success_distance_m=self.distance_m or 0.0,
            success_angle_deg=self.angle_deg or 0.0,
        )
        if self.graph is not None:
            asking = env.task.asking(graph=self.graph)
            env = replace(env, task=asking)
        robot = Path(self.robot).stem
        cells = []
        for split in self.splits or (None,):
            test = () if split is None else (SplitTest(split=split),)
            how = EvaluationConfig(
                distance_m=env.success_distance_m,
                angle_deg=env.success_angle_deg,
                test=test,
            )
            name = "-".join(filter(None, [robot, split]))
            cells.append(freeze_cell(name, env, how, self.episodes, _report))
        about = (
            f"{env.task.name} on {robot}, within {100 * env.success_distance_m:g} cm and "
            f"{env.success_angle_deg:g} degrees."
        )
        suite = write_suite(
            self.to,
            about,
            cells,
            training_seeds=self.training_seeds,
            control_episodes=self.control_episodes,
        )
        print(f"Wrote {self.to}: digest {suite.digest[:16]}")
        run = ["knowarm", "benchmark", "run", str(self.to), "--policy", "oracle"]
        print(shlex.join(run))


@dataclass(frozen=True, kw_only=True)
class RunSuite:
    """Play a suite with a policy and its controls, and write a row."""

    suite: Annotated[Positional[str], arg(metavar="SUITE")]
    """Name of a suite: see `knowarm benchmark show`; or the folder of one of `freeze`."""
    policy: Policies
    """Run folders of the training seeds of one agent, seen:RUN, a folder of `knowarm export`, ONNX
    files, ws://HOST:PORT, package.module:Name, package.module:Name:FILE, or a scripted agent. All
    but run folders and scripted agents must come from people whose code you would run."""
    out: Annotated[Path, arg(metavar="FILE")] = Path("row.json")
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

    row: Annotated[Positional[Path], arg(metavar="ROW")]
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
            measured = row.get("mujoco", "a version that it does not state")
            how = (
                f"played again with the same outcomes on MuJoCo {version('mujoco')}; it was "
                f"measured on {measured}"
            )
        print(f"{self.row}: {how}.")


@dataclass(frozen=True, kw_only=True)
class WriteTable:
    """Write a leaderboard, as HTML and as Markdown, from a folder of rows."""

    rows: Annotated[Positional[Path], arg(metavar="DIR")]
    """Folder of rows."""
    out: Annotated[Path, arg(metavar="FILE")] = Path("leaderboard.html")
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
    "freeze": FreezeSuite,
    "run": RunSuite,
    "verify": VerifyRow,
    "table": WriteTable,
}
"""Commands of the group `knowarm benchmark`, by name."""
