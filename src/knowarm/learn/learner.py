"""Learner of PPO: inference and minibatch gradients, in one process or shared by several.

PyTorch's threads share every single operation, of which a recurrent policy has many small ones:
threads synchronize after each and take time from physics and rendering by spinning. Processes that
each compute the entire network for a part of the environments avoid this (docs/lab-notes.md).
"""

import logging
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from knowarm.cores import available_cores, torch_threads
from knowarm.learn.algorithms import PPOConfig
from knowarm.learn.losses import PPOLossTerms
from knowarm.learn.parallel.processes import (
    ChildProcess,
    Restarted,
    SupervisedProcess,
    process_context,
    stop_all,
)
from knowarm.learn.parallel.shared_tensors import FlatParameters, SharedTensors, TensorSpecs, zeros
from knowarm.learn.rollout import (
    Rollout,
    Targets,
    TrainingNetwork,
    add_gradient,
    buffer_specs,
    buffers,
    infer_step,
)
from knowarm.policy import MakePolicy, MatmulPrecision, Policy, State

log = logging.getLogger("knowarm.learn")

MIN_ENVS_PER_PROCESS = 8
"""Smallest number of a minibatch's environments that is worth another process."""


class Learner:
    """Computes inference and minibatch gradients in one process.

    The collector and `infer` write ``rollout``, the trainer ``targets``; `compute_gradient` reads
    both and writes ``gradient``, (P,) float32, of all parameters of ``network``.

    Attributes:
        processes: number of processes that share the work.
    """

    processes = 1
    rollout: Rollout
    targets: Targets
    gradient: Tensor

    def __init__(self, network: TrainingNetwork, config: PPOConfig, device: torch.device) -> None:
        self.network = network
        self.policy = network.policy
        self._config = config
        self._allocate(device)

    def _allocate(self, device: torch.device) -> None:
        tensors = zeros(buffer_specs(self.network, self._config), device)
        self.rollout, self.targets = buffers(tensors)
        self.gradient = FlatParameters(self.network).gradient

    def running(self) -> AbstractContextManager[None]:
        """Use one PyTorch thread until the context ends."""
        return torch_threads(1)

    def infer(self, rollout: Rollout, t: int, image: Tensor, state: State) -> tuple[Tensor, State]:
        """Run the policy for step t, as `infer_step`; the next call may overwrite the state."""
        return infer_step(self.policy, rollout, t, image, state)

    def compute_gradient(self, env_ids: Tensor) -> PPOLossTerms:
        """Compute loss terms and gradient over the environments ``env_ids`` (b,) int64."""
        self.gradient.zero_()
        return add_gradient(self.network, self._config, self.rollout, self.targets, env_ids)


class InferCommand(NamedTuple):
    """To a worker: run the policy for step ``t`` of the environments ``envs``."""

    t: int
    envs: slice


class GradientCommand(NamedTuple):
    """To a worker: compute the gradient over ``env_ids``, weighted; see `add_gradient`."""

    env_ids: np.ndarray
    weight: float


def shared_specs(network: TrainingNetwork, config: PPOConfig, processes: int) -> TensorSpecs:
    """Return shapes and dtypes of the tensors that trainer and workers share."""
    policy, count = network.policy, config.num_envs
    shape = policy.shape
    parameters = sum(p.numel() for p in network.parameters())
    return {
        **buffer_specs(network, config),
        "parameters": ((parameters,), torch.float32),
        "gradients": ((processes, parameters), torch.float32),
        "terms": ((processes, len(PPOLossTerms.names())), torch.float32),
        "image": ((count, shape.image_size, shape.image_size, 3), torch.uint8),
        "h": ((count, policy.hidden_size), torch.float32),
        "c": ((count, policy.hidden_size), torch.float32),
        "logits": ((count, shape.joints, shape.levels), torch.float32),
    }


def infer_shared(
    policy: Policy, rollout: Rollout, shared: SharedTensors, t: int, image: Tensor, envs: slice
) -> None:
    """Run the policy for step t of ``envs``; recurrent states and logits are shared tensors."""
    state = (shared["h"], shared["c"])
    logits, (h, c) = infer_step(policy, rollout, t, image, state, envs)
    shared["logits"][envs] = logits
    shared["h"][envs] = h
    shared["c"][envs] = c


def run_learner_worker(
    make_policy: MakePolicy,
    auxiliary_targets: int,
    config: PPOConfig,
    precision: MatmulPrecision,
    shared: SharedTensors,
    index: int,
    connection: Connection,
) -> None:
    """Entry point of a learner worker: execute commands until the parent process exits.

    Every command is answered with true once its results are in shared memory.
    """
    policy = make_policy()
    policy.matmul_precision = precision
    network = TrainingNetwork(policy, auxiliary_targets)
    gradient = shared["gradients"][index]
    FlatParameters(network, shared["parameters"], gradient)
    rollout, targets = buffers(shared.tensors)
    while True:
        command = connection.recv()
        if isinstance(command, InferCommand):
            infer_shared(policy, rollout, shared, command.t, shared["image"], command.envs)
        else:
            gradient.zero_()
            env_ids = torch.from_numpy(command.env_ids)
            terms = add_gradient(network, config, rollout, targets, env_ids, command.weight)
            shared["terms"][index] = terms.vector()
        connection.send(True)


class DataParallelLearner(Learner):
    """Learner in several processes that share parameters, rollout and targets.

    Workers keep no state between two commands, so one that dies is restarted without loss. Sums
    are taken in another order than in one process, always the same for a number of processes. The
    calling process counts among ``processes``, of which there are at least 2.
    """

    def __init__(
        self,
        network: TrainingNetwork,
        config: PPOConfig,
        precision: MatmulPrecision,
        processes: int,
    ) -> None:
        self.processes = processes
        self._context = process_context()
        self._precision = precision
        self._workers: list[SupervisedProcess] = []
        super().__init__(network, config, torch.device("cpu"))

    def _allocate(self, device: torch.device) -> None:
        specs = shared_specs(self.network, self._config, self.processes)
        self._shared = SharedTensors(self._context, specs)
        self.rollout, self.targets = buffers(self._shared.tensors)
        self.gradient = self._shared["gradients"][0]
        self._shared["parameters"].copy_(FlatParameters(self.network).values)
        FlatParameters(self.network, self._shared["parameters"], self.gradient)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run the workers, and use one PyTorch thread per process, until the context ends."""
        with super().running():
            try:
                for index in range(1, self.processes):
                    self._workers.append(SupervisedProcess(partial(self._start, index)))
                yield
            finally:
                stop_all([worker.child for worker in self._workers])
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
        weight = len(own) / count
        terms = add_gradient(
            self.network, self._config, self.rollout, self.targets, own, weight
        ).vector()
        self._wait(commands)
        for index in range(1, 1 + len(commands)):
            self.gradient += self._shared["gradients"][index]
            terms += self._shared["terms"][index]
        return PPOLossTerms.from_vector(terms)

    def _start(self, index: int, restarts: int) -> ChildProcess:
        network = self.network
        arguments = network.policy.maker(), network.auxiliary_targets, self._config, self._precision
        name = f"learner worker {index}"
        return ChildProcess.start(
            self._context, name, run_learner_worker, *arguments, self._shared, index
        )

    def _send(self, commands: Sequence[InferCommand | GradientCommand]) -> None:
        for worker, command in zip(self._workers, commands, strict=False):
            worker.child.send(command)

    def _wait(self, commands: Sequence[InferCommand | GradientCommand]) -> None:
        """Wait until every worker has executed its command; a restarted one executes it again."""
        for worker, command in zip(self._workers, commands, strict=False):
            while isinstance(worker.receive(), Restarted):
                worker.child.send(command)


def make_learner(
    network: TrainingNetwork, config: PPOConfig, precision: MatmulPrecision, device: torch.device
) -> Learner:
    """Move the network to the device and create its learner, with `count_processes` on the CPU."""
    network.to(device)
    torch.backends.cudnn.allow_tf32 = False  # float32 means float32 in convolutions, too
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
    return Learner(network, config, device)


def count_processes(config: PPOConfig) -> int:
    """Return the number of processes: as configured, limited by the size of a minibatch."""
    most = config.num_envs // config.minibatches // MIN_ENVS_PER_PROCESS
    return max(1, min(config.processes or available_cores(), most))
