"""A function in a fork of this process, which saves the seconds that imports take."""

import gc
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any


class Forked:
    """A running function that returns an exit code; its output goes into two files.

    Args:
        function: what runs, such as ``lambda: main(["list"])``.
        folder: where the files ``stdout`` and ``stderr`` are written; must exist.
        cwd: its working directory.
        environment: variables that are added.
        forget: packages that it imports anew, with these variables.
    """

    def __init__(
        self,
        function: Callable[[], int | None],
        folder: Path,
        *,
        cwd: Path | None = None,
        environment: Mapping[str, str] | None = None,
        forget: Sequence[str] = (),
    ) -> None:
        self._files = folder / "stdout", folder / "stderr"

        def run() -> None:
            # What it inherits is not its own to end: threads of a simulation are not in a fork.
            gc.freeze()
            signal.signal(signal.SIGINT, signal.default_int_handler)
            for descriptor, path in enumerate(self._files, 1):
                os.dup2(
                    os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), descriptor
                )
            sys.stdout, sys.stderr = (open(fd, "w", closefd=False) for fd in (1, 2))  # noqa: SIM115
            os.environ.update(environment or {})
            os.chdir(cwd or Path.cwd())
            for name in [each for each in sys.modules if each.split(".")[0] in forget]:
                del sys.modules[name]
            code = 1
            try:
                code = function() or 0
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(code)

        self.process: Any = multiprocessing.get_context("fork").Process(target=run)
        self.process.start()

    def ended(self, seconds: float) -> bool:
        """Wait for the end; return whether it came."""
        self.process.join(seconds)
        return self.process.exitcode is not None

    @property
    def returncode(self) -> int | None:
        return self.process.exitcode

    @property
    def stdout(self) -> str:
        return self._files[0].read_text()

    @property
    def stderr(self) -> str:
        return self._files[1].read_text()
