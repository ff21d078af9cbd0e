"""Long form of all campaigns: ``make torture``, or ``python -m tests.robustness.torture``.

Ends with exit code 1 if there is a failure.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from tests.robustness.command_kills import kill_commands, refuse_writes
from tests.robustness.edges import clocks, forged_rows, links, permuted_doors, sockets
from tests.robustness.faults import inject_file_errors
from tests.robustness.formats import make_formats, try_mutations
from tests.robustness.study_storm import kill_study

Result = tuple[int, list[str]]


def mutations(tries: int, seed: int) -> Result:
    """Try an equal number of mutations of every format."""
    failures = []
    with tempfile.TemporaryDirectory() as folder:
        formats = make_formats(Path(folder))
        each = -(-tries // len(formats))
        for one in formats:
            failures += try_mutations(one, range(seed, seed + each))
        return each * len(formats), failures


CAMPAIGNS: dict[str, tuple[int, Callable[[int, int], Result]]] = {
    "kill -9": (20, kill_study),
    "killed commands": (20, kill_commands),
    "full disks, other users": (100, refuse_writes),
    "mutations of files": (26_500, mutations),
    "injected file errors": (500, inject_file_errors),
    "links": (300, links),
    "clocks": (3_000, clocks),
    "sockets": (500, sockets),
    "forged rows": (500, forged_rows),
    "permuted doors": (90, permuted_doors),
}
"""Tries of the long form, and the function that makes them."""


def main() -> int:
    """Run the campaigns that the arguments name, and print tries and failures of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--only", default="", help="part of the names of the campaigns to run"
    )
    parser.add_argument("--scale", type=float, default=1.0, help="share of the tries")
    parser.add_argument(
        "--seed", type=int, default=0, help="another one makes other tries"
    )
    given = parser.parse_args()
    failed = False
    for name, (tries, campaign) in CAMPAIGNS.items():
        if given.only not in name:
            continue
        begin = time.monotonic()
        count, failures = campaign(max(1, round(tries * given.scale)), given.seed)
        minutes = (time.monotonic() - begin) / 60
        print(
            f"{name}: {count:,} tries, {len(failures)} failures, {minutes:.1f} min",
            flush=True,
        )
        for failure in failures[:20]:
            print(f"    {failure}", flush=True)
        failed |= bool(failures)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
