"""Campaign against stored tables: one cell is damaged at a time, for every command reading it."""

import contextlib
import csv
import io
import json
import random
import shutil
import tempfile
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from knowarm.cli.main import main
from knowarm.study import driver
from knowarm.study.driver import run_study
from tests.robustness.formats import outcome
from tests.robustness.mutator import VALUES
from tests.study.tiny import InlineExecutor, tiny

CELLS = ["", "abc", "nan", "inf", "-1", "1e308", "9" * 400, "[/x]", "\0", '"', "=1+1", "\x1b[31m"]
"""What a cell of a CSV file is replaced by; those of JSON are `VALUES`."""
RUN = "irb120-bm-ppo/0"
QUICK = ("status", "retry", "stop", "show")
"""Commands that are tried on every damage, beside one of the others."""


class Damage(NamedTuple):
    """One changed cell: its file, a name of the change, and the bytes of the file with it."""

    path: Path
    name: str
    data: bytes


def damages(folder: Path) -> Iterator[Damage]:
    """Yield every change of one cell of every stored table of a study's first run."""
    for path in sorted((folder / RUN).rglob("*")):
        if path.suffix == ".csv":
            yield from _csv(path)
        elif path.suffix == ".json":
            yield from _json(path)
        elif path.suffix == ".parquet":
            yield from _parquet(path)
    yield from _json(folder / "study.json")


def _csv(path: Path) -> Iterator[Damage]:
    rows = list(csv.reader(path.read_text().splitlines()))
    for i, j in product(range(len(rows)), range(len(rows[0]))):
        for cell in CELLS:
            changed = [list(row) for row in rows]
            changed[i][j] = cell
            text = io.StringIO()
            csv.writer(text, lineterminator="\n").writerows(changed)
            yield Damage(path, f"{path.name} row {i} {rows[0][j]} {cell!r:.20}", _bytes(text))


def _json(path: Path) -> Iterator[Damage]:
    whole = json.loads(path.read_text())
    for holder, key, name in list(_places(whole)):
        kept = holder[key]
        for value in VALUES:
            holder[key] = value
            yield Damage(path, f"{path.name} {name} {value!r:.20}", json.dumps(whole).encode())
        holder[key] = kept


def _parquet(path: Path) -> Iterator[Damage]:
    table = pq.read_table(path)
    for i, name in enumerate(table.column_names):
        values = table[name].to_pylist()
        for cell in (None, float("nan"), -1, "[/x]", [1]):
            with contextlib.suppress(pa.ArrowException):  # no table has such a column
                column = pa.array([cell, *values[1:]] if cell is None else [cell] * len(values))
                changed = table.set_column(i, name, column)
                file = io.BytesIO()
                pq.write_table(changed, file)
                yield Damage(path, f"{path.name} {name} {cell!r}", file.getvalue())


def _places(value: Any, name: str = "") -> Iterator[tuple[Any, Any, str]]:
    """Yield every holder and key of a JSON value, with a name."""
    keys = list(value) if isinstance(value, dict) else range(len(value)) if _is_list(value) else []
    for key in keys:
        yield value, key, f"{name}.{key}"
        yield from _places(value[key], f"{name}.{key}")


def _is_list(value: Any) -> bool:
    return isinstance(value, list)


def _bytes(text: io.StringIO) -> bytes:
    return text.getvalue().encode()


def commands(folder: Path, scratch: Path) -> dict[str, list[str]]:
    """Return the commands that read a study or its runs."""
    study, run = str(folder), str(folder / RUN)
    few = ["--episodes", "2", "--blind-episodes", "0", "--no-save"]
    return {
        "status": ["study", "status", study, "--json", str(scratch / "status.json")],
        "report": ["report", study, "--out", str(scratch / "r.html")],
        "run": ["study", "run", study],
        "retry": ["study", "retry", study],
        "stop": ["study", "stop", study],
        "show": ["study", "show", study],
        "pack": ["study", "pack", study, "--out", str(scratch / "p.tar.gz")],
        "evaluate": ["evaluate", run, *few],
        "resume": ["train", "irb120-bm-ppo", "--seed", "0", "--runs", study, "--resume"],
        "export": ["export", run, "--to", str(scratch / "exported")],
        "record": ["record", run, "--to", str(folder / "dataset"), "--episodes", "1"],
        "view": ["view", "--agent", run, "--episodes", "1", "--strip", str(scratch / "s.png")],
    }


def damage_cells(tries: int, seed: int) -> tuple[int, list[str]]:
    """Damage cells at random; status must show the other run as it is."""
    draws, failures = random.Random(seed), []
    with tempfile.TemporaryDirectory() as temporary, pytest.MonkeyPatch.context() as patch:
        patch.setattr(driver, "LocalExecutor", InlineExecutor)
        patch.setattr(driver, "POLL_S", 0.0)
        patch.setattr(driver, "STATUS_S", 0.0)
        finished, folder = Path(temporary) / "finished", Path(temporary) / "study"
        run_study(tiny(), finished)
        found: dict[Path, list[Damage]] = {}
        for each in damages(finished):
            found.setdefault(each.path, []).append(each)
        curves = [path for path in found if path.suffix == ".csv"]
        called = commands(folder, Path(temporary))
        slow = [name for name in called if name not in QUICK]
        shutil.copytree(finished, folder)  # without damage, every command succeeds
        for arguments in called.values():
            with contextlib.redirect_stdout(io.StringIO()):
                _command(arguments, codes=(0,))()
        shutil.rmtree(folder)
        for number in range(tries):
            path = draws.choice(curves if number % 2 else list(found))
            damage = draws.choice(found[path])
            shutil.copytree(finished, folder)
            (folder / path.relative_to(finished)).write_bytes(damage.data)
            for name in (*QUICK, draws.choice(slow)):
                what = outcome(_command(called[name]))
                if name == "status" and what is None and path.name != "study.json":
                    states = json.loads((Path(temporary) / "status.json").read_text())["runs"]
                    what = None if states[1]["state"] == "done" else "the other run is not done"
                if what is not None:
                    failures.append(f"{name}, {damage.name}: {what}")
            shutil.rmtree(folder)
    return tries, failures


def _command(arguments: list[str], codes: tuple[int, ...] = (0, 1, 2)) -> Callable[[], object]:
    def run() -> None:
        errors = io.StringIO()
        with contextlib.redirect_stderr(errors):
            try:
                code = main(arguments)
            except SystemExit as ended:
                if ended.code != 1:  # an option that the command lacks
                    raise AssertionError(errors.getvalue()) from ended
                code = 1  # a run of the study is not done
        lines = [line for line in errors.getvalue().splitlines() if line.startswith("knowarm: ")]
        assert code in codes, f"exit code {code}"
        assert len(lines) == (code == 2), f"{lines}"

    return run
