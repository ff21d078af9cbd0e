"""Ray executor: one task per run on the nodes of a Ray cluster that share a folder."""

import contextlib
import importlib
import socket
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from knowarm.cores import limited_to
from knowarm.errors import UserError
from knowarm.study.executors.base import Ended, RunKey, Where, log_path

TIMEOUT_S = 5.0
"""How long to wait for an answer at the address [s]."""


@dataclass(frozen=True, kw_only=True)
class Ray(Where):
    """Nodes of a Ray cluster, which all see the study's folder under the same path.

    A lost run is tried again by Ray, ``retries`` times in all.
    """

    kind: Literal["ray"] = "ray"
    """Identifies the executor in a file."""

    address: str = "auto"
    """HOST:PORT of the head node; "auto" finds a cluster on this machine."""


class RayExecutor:
    """Submits Ray tasks; Ray ends them when this process exits.

    Args:
        where: the settings.
        out: the study's folder.

    Raises:
        UserError: Ray is not installed, no cluster answers, it refuses the token, or no node has
            what one run needs.
    """

    def __init__(self, where: Ray, out: Path) -> None:
        try:
            self._ray = importlib.import_module("ray")
        except ImportError as error:
            raise UserError(
                "The executor 'ray' needs Ray: pip install 'knowarm[ray]', on every node."
            ) from error
        self._where, self._out = where, out.absolute()
        self._tasks: dict[Any, RunKey] = {}
        self._connect()
        if not self.slots:
            raise UserError(
                f"One run needs {where.cores} cores, {where.memory_gib:g} GiB and {where.gpus:g} "
                f"GPUs, and no node of the cluster at {where.address} has them: choose smaller "
                "ones in 'where', or start other nodes."
            )
        self._work = self._ray.remote(
            num_cpus=where.cores,
            num_gpus=where.gpus,
            memory=int(where.memory_gib * 2**30),
            max_retries=where.retries,
            max_calls=1,  # a process of its own for each run
        )(_work)

    def _connect(self) -> None:
        address = self._where.address
        host, _, port = address.rpartition(":")
        try:
            if port.isdigit():
                socket.create_connection((host, int(port)), TIMEOUT_S).close()
        except OSError as error:
            raise UserError(
                f"No Ray cluster answers at {address} ({error.strerror or error}): start one with "
                "'ray start --head', or correct where.address."
            ) from error
        try:
            self._ray.init(
                address=address,
                log_to_driver=False,
                logging_level="ERROR",
                runtime_env={"env_vars": limited_to(self._where.cores)},
            )
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise UserError(
                f"The Ray cluster at {address} does not accept the connection "
                f"({' '.join(str(error).split())}). If it uses tokens, set RAY_AUTH_MODE=token, "
                "and RAY_AUTH_TOKEN or RAY_AUTH_TOKEN_PATH to the token of the head node; also "
                "compare the versions of Ray and Python."
            ) from error

    @property
    def slots(self) -> int:
        """As `Executor.slots`: how many runs the live nodes hold."""
        needs = {
            "CPU": self._where.cores,
            "memory": self._where.memory_gib * 2**30,
            "GPU": self._where.gpus,
        }
        return sum(
            min(int(node["Resources"].get(name, 0) / need) for name, need in needs.items() if need)
            for node in self._ray.nodes()
            if node["Alive"]
        )

    def start(self, run: RunKey) -> None:
        """As `Executor.start`."""
        self._tasks[self._work.options(name="/".join(map(str, run))).remote(self._out, run)] = run

    def ended(self) -> list[Ended]:
        """As `Executor.ended`."""
        if not self._tasks:
            return []
        tasks = list(self._tasks)
        ended = []
        for task in self._ray.wait(tasks, num_returns=len(tasks), timeout=0)[0]:
            run, problem = self._tasks.pop(task), None
            try:
                self._ray.get(task)
            except self._ray.exceptions.RayError as error:
                problem = f"{type(error).__name__}: {str(error).strip().splitlines()[-1]}"
            ended.append(Ended(run, problem))
        return ended

    def stop(self) -> None:
        """As `Executor.stop`: tasks see the file in the folder that they share."""
        from knowarm.study.worker import STOP

        (self._out / STOP).touch()

    def close(self) -> None:
        """As `Executor.close`."""
        for task in self._tasks:
            with contextlib.suppress(self._ray.exceptions.RayError):
                self._ray.cancel(task, force=True)
        self._tasks.clear()
        self._ray.shutdown()


def _work(out: Path, run: RunKey) -> None:
    """Work on a run inside a Ray task."""
    started = time.time()
    from knowarm.study.worker import work  # imports torch

    with (
        log_path(out, run).open("a", buffering=1) as log,
        contextlib.redirect_stdout(log),
        contextlib.redirect_stderr(log),
    ):
        work(out, run, started)
