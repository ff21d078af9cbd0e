"""Mutation testing: apply each of `tests.mutations` to a copy of the tree and run its tests.

``make mutate``, or ``python -m tests.mutate [WORD ...]`` for the mutations whose names contain one
of the words. Fails if more than two mutations survive.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tests.mutations import MUTATIONS, Mutation

ROOT = Path(__file__).parent.parent
COPIED = ("src", "tests", "pyproject.toml", "examples")
MOST_SURVIVORS = 2
TIME_LIMIT_S = 600


def copy_tree(folder: Path) -> None:
    """Copy what the tests need; caches of compiled kernels as well."""
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name)
        else:
            shutil.copy2(source, folder / name)


def mutated(mutation: Mutation, root: Path = ROOT) -> str:
    """Return the text of the mutated file.

    Raises:
        ValueError: the text to replace does not occur exactly once.
    """
    text = (root / "src" / "knowarm" / mutation.file).read_text()
    count = text.count(mutation.before)
    if count != 1:
        raise ValueError(
            f"{mutation.name}: {mutation.before!r} occurs {count} times in {mutation.file}."
        )
    return text.replace(mutation.before, mutation.after)


def is_caught(mutation: Mutation, folder: Path) -> bool:
    """Apply a mutation to a copy of the tree, run its tests and restore the file.

    Raises:
        RuntimeError: pytest could not run the tests.
    """
    path = folder / "src" / "knowarm" / mutation.file
    text, times = path.read_text(), path.stat()
    path.write_text(mutated(mutation, folder))
    try:
        code = run_tests(mutation.tests.split(), folder)
    finally:
        path.write_text(text)
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    if code not in (0, 1):
        raise RuntimeError(f"{mutation.name}: pytest exited with {code} ({mutation.tests}).")
    return code == 1


def run_tests(tests: Sequence[str], folder: Path) -> int:
    """Run tests in a copy of the tree; return pytest's exit status, 1 if one failed."""
    python_path = os.pathsep.join((str(folder / "src"), str(folder)))
    environment = os.environ | {"PYTHONPATH": python_path, "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
    result = subprocess.run(
        [*command, "-m", "not slow", *tests],
        cwd=folder,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        timeout=TIME_LIMIT_S,
    )
    return result.returncode


def main(words: Sequence[str]) -> int:
    """Run the mutations, print what happened, and return the exit status."""
    chosen = [m for m in MUTATIONS if not words or any(word in m.name for word in words)]
    survivors = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        copy_tree(folder)
        for number, mutation in enumerate(chosen, 1):
            start = time.monotonic()
            caught = is_caught(mutation, folder)
            if not caught:
                survivors.append(mutation.name)
            outcome = "caught" if caught else "SURVIVED"
            seconds = time.monotonic() - start
            print(f"{number:3} {outcome:9} {seconds:4.0f} s  {mutation.name}", flush=True)
    print(f"{len(chosen) - len(survivors)} of {len(chosen)} mutations caught.")
    return int(len(survivors) > MOST_SURVIVORS)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("words", nargs="*", metavar="WORD")
    sys.exit(main(parser.parse_args().words))
