"""Worker pool: A3C's worker processes, their messages, and restarts of those that die."""

import logging
from collections.abc import Callable, Iterator
from typing import Any

import psutil

from knowarm.errors import UserError
from knowarm.learn.a3c.messages import UpdateReport, WorkerRestarted
from knowarm.learn.config import A3CConfig
from knowarm.learn.processes import (
    ChildProcess,
    ProcessFailure,
    stop_all,
    wait_for_messages,
)

log = logging.getLogger("knowarm.learn")

MAX_EXITS = 3
"""Consecutive exits of a worker without an update after which training stops."""

PROCESS_BYTES = 160 * 2**20
"""Private memory of a worker without its environments; measured (docs/learning.md)."""

IMAGE_COPIES = 12
"""Memory of a gradient step as a multiple of the rollout's images in bytes; measured (11)."""


class WorkerPool:
    """The worker processes.

    Args:
        start_worker: starts worker ``index``; the second argument counts its former processes.
        restarts: number of former processes of each worker; updated in place.
        should_stop: asked between two starts; once true, the remaining workers are not started.
    """

    def __init__(
        self,
        start_worker: Callable[[int, int], ChildProcess],
        restarts: list[int],
        should_stop: Callable[[], bool],
    ) -> None:
        self._start_worker = start_worker
        self._restarts = restarts
        self.workers: list[ChildProcess] = []
        for index, count in enumerate(restarts):
            if should_stop():
                break
            self.workers.append(start_worker(index, count))
        self._exiting: set[int] = set()
        self._exits_in_a_row: dict[int, int] = {}

    def expect_exit(self, index: int) -> None:
        """Do not restart worker ``index`` when it exits."""
        self._exiting.add(index)

    def read(self, timeout_s: float) -> Iterator[tuple[int, Any]]:
        """Yield the messages that arrive within ``timeout_s``, as (worker index, message).

        A worker that died is restarted, and a `WorkerRestarted` is yielded.

        Raises:
            UserError: a worker raised one; it would occur in the others as well.
            RuntimeError: a worker exits or fails repeatedly.
        """
        watched = {i: child for i, child in enumerate(self.workers) if i not in self._exiting}
        ready = wait_for_messages(list(watched.values()), timeout_s)
        for index, child in watched.items():
            if child not in ready:
                continue
            for message in child.messages():
                if isinstance(message, ProcessFailure):
                    self._handle_failure(index, message)
                elif message is not None:
                    if isinstance(message, UpdateReport):
                        self._exits_in_a_row.pop(index, None)
                    yield index, message
                elif index not in self._exiting:
                    yield index, self._restart(index)

    def stop(self) -> None:
        """Kill all workers; those whose last state has arrived have nothing left to do."""
        stop_all(self.workers, 0.0)

    def _handle_failure(self, index: int, failure: ProcessFailure) -> None:
        if failure.user_error is not None:
            raise failure.user_error
        if self._exits_in_a_row.get(index, 0) + 1 >= MAX_EXITS:
            raise RuntimeError(f"Worker {index} fails repeatedly.\n{failure.traceback}")
        log.warning("Worker %d failed: %s", index, failure.summary)

    def _restart(self, index: int) -> WorkerRestarted:
        child = self.workers[index]
        exits = self._exits_in_a_row[index] = self._exits_in_a_row.get(index, 0) + 1
        reason = child.exit_reason()
        child.stop()
        if exits >= MAX_EXITS:
            raise RuntimeError(f"Worker {index} {reason}; {exits} times in a row.")
        log.warning("Worker %d %s; restarting it.", index, reason)
        self._restarts[index] += 1
        self.workers[index] = self._start_worker(index, self._restarts[index])
        return WorkerRestarted()


def check_memory(config: A3CConfig, *, image_bytes: int, parameters: int) -> None:
    """Check that the free memory is large enough for the workers.

    Args:
        config: number of workers and environments.
        image_bytes: size of one image [bytes].
        parameters: number of parameters; a worker holds values, gradient and temporaries of them.

    Raises:
        UserError: it is not; the message names the number of workers that fits.
    """
    rollout = config.rollout_steps * config.envs_per_worker * image_bytes * IMAGE_COPIES
    each = PROCESS_BYTES + rollout + 5 * 4 * parameters
    available = psutil.virtual_memory().available
    fitting = max(0, int(available // each) - 1)
    if config.workers > fitting:
        raise UserError(
            f"{config.workers} workers and the evaluator need about "
            f"{(config.workers + 1) * each / 2**30:.1f} GiB of memory and "
            f"{available / 2**30:.1f} GiB are free: choose at most {fitting} workers, or fewer "
            "envs_per_worker."
        )
