"""Data-parallel learner: several processes share each inference step and minibatch gradient.

PyTorch's threads share every single operation. The operations of a recurrent policy are many and
small: threads synchronize after each of them, and by spinning while they wait they take time from
physics and rendering; Python threads are serialized by the interpreter lock. Processes that each
compute the entire network for a part of the environments avoid both (docs/lab-notes.md).
"""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import torch
from torch import Tensor

from knowarm.cores import available_cores
from knowarm.learn.config import PPOConfig
from knowarm.learn.flat_parameters import FlatParameters
from knowarm.learn.learner import Learner
from knowarm.learn.learner_worker import (
    GradientCommand,
    InferCommand,
    LearnerWorkerArgs,
    infer_shared,
    run_learner_worker,
    shared_specs,
)
from knowarm.learn.losses import PPOLossTerms
from knowarm.learn.minibatch import Targets, TrainingNetwork, add_gradient, target_specs
from knowarm.learn.processes import ChildProcess, ProcessFailure, process_context, stop_all
from knowarm.learn.rollout import Rollout, rollout_specs
from knowarm.learn.shared_tensors import SharedTensors
from knowarm.policy import MatmulPrecision, State

log = logging.getLogger("knowarm.learn")

MIN_ENVS_PER_PROCESS = 8
"""Smallest number of a minibatch's environments that is worth another process."""

MAX_EXITS = 3
"""Unexpected exits of workers after which training stops."""


class DataParallelLearner(Learner):
    """Learner in several processes that share parameters, rollout and targets.

    Workers keep no state between two commands, so one that dies is restarted without loss. Sums
    are taken in another order than in one process, always the same for a number of processes.

    Args:
        network: on the CPU; its parameters move to shared memory.
        config: rollout size and loss weights.
        precision: of the matrix products in encoder and LSTM.
        processes: number of processes, the calling one included; at least 2.
    """

    def __init__(
        self,
        network: TrainingNetwork,
        config: PPOConfig,
        precision: MatmulPrecision,
        processes: int,
    ) -> None:
        assert processes > 1, processes
        self.processes = processes
        self._context = process_context(["knowarm.learn.learner_worker"])
        self._args = LearnerWorkerArgs(
            network.policy.spec(), network.auxiliary_targets, config, precision
        )
        self._workers: list[ChildProcess] = []
        self._exits = 0
        super().__init__(network, config, precision, torch.device("cpu"))

    def _allocate(self) -> None:
        network, config = self.network, self._config
        self._shared = SharedTensors(self._context, shared_specs(network, config, self.processes))
        self._shared["parameters"].copy_(FlatParameters(network).values)
        self.gradient = self._shared["gradients"][0]
        FlatParameters.bind(network, self._shared["parameters"], self.gradient)
        steps, count = config.rollout_steps, config.num_envs
        self.rollout = Rollout(**self._shared.select(rollout_specs(steps, count, self.policy)))
        specs = target_specs(steps, count, network.auxiliary_targets)
        self.targets = Targets(**self._shared.select(specs))

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run the workers, and use one PyTorch thread per process, until the context ends."""
        with super().running():
            try:
                self._workers = [self._start(index) for index in range(1, self.processes)]
                yield
            finally:
                stop_all(self._workers)
                self._workers = []

    def infer(self, rollout: Rollout, t: int, image: Tensor, state: State) -> tuple[Tensor, State]:
        """As `Learner.infer`."""
        shared = self._shared
        bounds = [len(image) * i // self.processes for i in range(self.processes + 1)]
        own, *others = map(slice, bounds, bounds[1:])
        shared["image"][own.stop :] = image[own.stop :]
        if state[0] is not shared["h"]:
            shared["h"].copy_(state[0])
            shared["c"].copy_(state[1])
        commands = [InferCommand(t, envs) for envs in others]
        self._send(commands)
        infer_shared(self.policy, rollout, shared, t, image, own)
        self._wait(commands)
        return shared["logits"].clone(), (shared["h"], shared["c"])

    def compute_gradient(self, env_ids: Tensor) -> PPOLossTerms:
        """As `Learner.compute_gradient`."""
        count = len(env_ids)
        own, *others = env_ids.chunk(self.processes)
        commands = [GradientCommand(part.numpy(), len(part) / count) for part in others]
        self._send(commands)
        self.gradient.zero_()
        terms = add_gradient(
            self.network, self._config, self.rollout, self.targets, own, len(own) / count
        )
        self._wait(commands)
        for index in range(1, 1 + len(commands)):
            self.gradient += self._shared["gradients"][index]
            terms = terms + PPOLossTerms.from_vector(self._shared["terms"][index])
        return terms

    def _start(self, index: int) -> ChildProcess:
        return ChildProcess.start(
            self._context,
            f"learner worker {index}",
            run_learner_worker,
            self._args,
            index,
            self._shared,
        )

    def _send(self, commands: Sequence[InferCommand | GradientCommand]) -> None:
        for worker, command in zip(self._workers, commands, strict=False):
            worker.send(command)

    def _wait(self, commands: Sequence[InferCommand | GradientCommand]) -> None:
        """Wait until every worker has executed its command; restart workers that exit.

        Raises:
            UserError: a worker raised one.
            RuntimeError: a worker raised another exception, or workers exit repeatedly.
        """
        for index, command in enumerate(commands):
            while True:
                worker = self._workers[index]
                try:
                    answer = worker.connection.recv()
                except (EOFError, ConnectionResetError):
                    self._restart(index)
                    self._workers[index].send(command)
                    continue
                if isinstance(answer, ProcessFailure):
                    if answer.user_error is not None:
                        raise answer.user_error
                    raise RuntimeError(f"The {worker.name} failed.\n{answer.traceback}")
                break

    def _restart(self, index: int) -> None:
        worker = self._workers[index]
        reason = worker.exit_reason()
        worker.stop()
        self._exits += 1
        if self._exits >= MAX_EXITS:
            raise RuntimeError(
                f"The {worker.name} {reason}; {self._exits} workers have exited. A script that "
                'trains needs `if __name__ == "__main__":` around its code; processes=1 runs '
                "without workers."
            )
        log.warning("The %s %s; restarting it.", worker.name, reason)
        self._workers[index] = self._start(index + 1)


def make_learner(
    network: TrainingNetwork, config: PPOConfig, precision: MatmulPrecision, device: torch.device
) -> Learner:
    """Create a learner with the number of processes of `count_processes`; one on a GPU.

    Args:
        network: moved to the device.
        config: sizes and number of processes.
        precision: of the matrix products in encoder and LSTM.
        device: where to learn.
    """
    network.to(device)
    processes = count_processes(config) if device.type == "cpu" else 1
    if device.type == "cpu" and config.processes is not None and processes < config.processes:
        log.warning(
            "processes=%d is reduced to %d: minibatches have %d environments, and each process "
            "needs %d of them.",
            config.processes,
            processes,
            config.num_envs // config.minibatches,
            MIN_ENVS_PER_PROCESS,
        )
    if processes > 1:
        return DataParallelLearner(network, config, precision, processes)
    return Learner(network, config, precision, device)


def count_processes(config: PPOConfig) -> int:
    """Return the number of processes: as configured, limited by the size of a minibatch."""
    most = config.num_envs // config.minibatches // MIN_ENVS_PER_PROCESS
    return max(1, min(config.processes or available_cores(), most))
