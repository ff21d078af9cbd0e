"""Executor of a study on a Ray cluster: one task per run, with its cores, memory and GPUs.

Every node needs this Python environment, and the study's folder under the same path.
"""

import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from knowarm.cores import LIMIT, limited_to
from knowarm.errors import UserError
from knowarm.study.executor import TIMEOUT_S, Ended, RunKey, Where, start_worker
from knowarm.study.worker import STOP


def work_on_node(out: str, run: RunKey, environment: Mapping[str, str]) -> int:
    """Start the worker of a run on this node, and return its exit code."""
    return start_worker(Path(out), run, environment).wait()


class RayExecutor:
    """Tasks of the Ray cluster that the environment variable ``RAY_ADDRESS`` or this node names.

    A task whose process or node dies counts as killed, and its run resumes elsewhere.

    Raises:
        UserError: Ray is not installed, there is no cluster, or no node is large enough for a run.
    """

    def __init__(self, where: Where, out: Path) -> None:
        self._where = where
        self._out = out.absolute()
        self._tasks: dict[Any, RunKey] = {}
        self._deadline: float | None = None
        try:
            import ray
        except ImportError:
            raise UserError(
                "The executor 'ray' needs Ray: pip install 'knowarm[ray]' on every node."
            ) from None
        self._ray = ray
        try:
            ray.init(address="auto", log_to_driver=False, configure_logging=False)
        except ConnectionError:
            raise UserError(
                "There is no Ray cluster here. Start one with `ray start --head`, let other nodes "
                "join with `ray start --address HOST:6379`, or name it in RAY_ADDRESS."
            ) from None
        needed = {
            "CPU": float(where.cores),
            "memory": where.memory_gib * 2**30,
            "GPU": where.gpus,
        }
        nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        if not any(_has(node, needed) for node in nodes):
            raise UserError(
                f"No node of the Ray cluster has the {where.cores} cores, {where.memory_gib:g} GiB "
                f"and {where.gpus:g} GPUs of one run: choose smaller where.cores, memory_gib or "
                "gpus, or start a larger node."
            )
        self._task = ray.remote(work_on_node).options(
            num_cpus=where.cores,
            memory=int(needed["memory"]),
            num_gpus=where.gpus,
            max_retries=0,  # the driver starts it again, and knows how often
        )
        # Own robots, tasks and algorithms that are registered here
        self._environment = limited_to(where.cores)
        for name, value in os.environ.items():
            if name.startswith("KNOWARM_") and name != LIMIT:
                self._environment.setdefault(name, value)

    @property
    def slots(self) -> int:
        """Runs that the nodes can hold at once; they may come and go."""
        cores = self._ray.cluster_resources().get("CPU", 0)
        return self._where.at_once or max(1, int(cores // self._where.cores))

    def start(self, run: RunKey) -> None:
        """Submit the task of a run."""
        self._tasks[self._task.remote(str(self._out), run, self._environment)] = run

    def ended(self) -> list[Ended]:
        """Return the tasks that have ended since the last call."""
        if self._deadline is not None and time.monotonic() > self._deadline:
            for task in self._tasks:
                self._ray.cancel(task, force=True)
        tasks = list(self._tasks)
        if not tasks:
            return []
        ready, _ = self._ray.wait(tasks, num_returns=len(tasks), timeout=0)
        return [self._end(task, self._tasks.pop(task)) for task in ready]

    def stop(self) -> None:
        """Ask all workers to save a checkpoint and end, by a file in the study's folder."""
        (self._out / STOP).touch()
        self._deadline = self._deadline or time.monotonic() + TIMEOUT_S

    def close(self) -> None:
        """End all tasks, and leave the cluster."""
        if self._tasks:
            self.stop()
        while self._tasks:
            self.ended()
            time.sleep(0.05)
        self._ray.shutdown()

    def _end(self, task: Any, run: RunKey) -> Ended:
        try:
            return Ended.with_code(run, self._ray.get(task))
        except self._ray.exceptions.RayError as error:
            how = type(error).__name__
            return Ended(run, f"its task was lost ({how})", killed=True)


def _has(resources: Mapping[str, float], needed: Mapping[str, float]) -> bool:
    return all(resources.get(name, 0) >= amount for name, amount in needed.items())
