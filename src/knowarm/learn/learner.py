"""Learner: inference and minibatch gradients, in one process or shared by several.

PyTorch's threads share every single operation, of which a recurrent policy has many small ones:
threads synchronize after each and take time from physics and rendering by spinning. Processes that
each compute the entire network for a part of the environments avoid this (docs/lab-notes.md).
"""

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from knowarm.cores import available_cores, torch_threads
from knowarm.learn.algorithms import MinibatchConfig
from knowarm.learn.losses import Terms
from knowarm.learn.network import Loss, Targets, TrainingNetwork
from knowarm.learn.parallel.processes import (
    ChildProcess,
    Restarted,
    SupervisedProcess,
    process_context,
    stop_all,
)
from knowarm.learn.parallel.shared_tensors import FlatParameters, SharedTensors, TensorSpecs, zeros
from knowarm.learn.rollout import Rollout, infer_step, rollout_specs
from knowarm.policy import MakePolicy, MatmulPrecision, Policy, State

log = logging.getLogger("knowarm.learn")

MIN_ENVS_PER_PROCESS = 8
"""Smallest number of a minibatch's environments that is worth another process."""

MAX_TERMS = 8
"""Most terms of a loss."""


def add_gradient(
    network: TrainingNetwork,
    loss: Loss,
    rollout: Rollout,
    targets: Targets,
    env_ids: Tensor,
    weight: float,
) -> Terms:
    """Add the gradient of the loss over the environments ``env_ids`` (b,) to those of the network.

    The loss has a factor ``weight``: b over the number of environments in the whole minibatch, so
    that the returned terms of a minibatch's parts add up to its own.
    """
    part = {name: target.index_select(1, env_ids) for name, target in targets.items()}
    terms = loss(network, rollout.of(env_ids), part)
    (terms["total"] * weight).backward()
    return {name: term.detach() * weight for name, term in terms.items()}


def _buffers(tensors: Mapping[str, Tensor]) -> tuple[Rollout, dict[str, Tensor]]:
    """Return rollout and targets that consist of tensors by name."""
    rollout = Rollout(**{name: tensors[name] for name in Rollout.__annotations__})
    prefix = "target/"
    targets = {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}
    return rollout, targets


class InferCommand(NamedTuple):
    """To a worker: run the policy for step ``t`` of the environments ``envs``."""

    t: int
    envs: slice


class GradientCommand(NamedTuple):
    """To a worker: compute the gradient over ``env_ids``, weighted; see `add_gradient`."""

    env_ids: np.ndarray
    weight: float


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
    loss: Loss,
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
    rollout, targets = _buffers(shared.tensors)
    while True:
        command = connection.recv()
        if isinstance(command, InferCommand):
            infer_shared(policy, rollout, shared, command.t, shared["image"], command.envs)
        else:
            gradient.zero_()
            env_ids = torch.from_numpy(command.env_ids)
            terms = add_gradient(network, loss, rollout, targets, env_ids, command.weight)
            shared["terms"][index, : len(terms)] = torch.stack([*terms.values()])
        connection.send(True)


class Learner:
    """Computes inference and minibatch gradients, in one process or on the CPU in several.

    The collector and `infer` write ``rollout``, the trainer ``targets``; `compute_gradient` reads
    both and writes ``gradient``, (P,) float32, of all parameters of ``network``, which is moved to
    the device.

    Worker processes share parameters, rollout and targets. They keep no state between two commands,
    so one that dies is restarted without loss. Sums are taken in another order than in one process,
    always the same for a number of processes.

    Attributes:
        processes: number of processes that share the work, the calling one among them.
    """

    rollout: Rollout
    targets: Targets
    gradient: Tensor

    def __init__(
        self,
        network: TrainingNetwork,
        config: MinibatchConfig,
        loss: Loss,
        targets: TensorSpecs,
        precision: MatmulPrecision,
        device: torch.device,
    ) -> None:
        self.network = network.to(device)
        self.policy = network.policy
        torch.backends.cudnn.allow_tf32 = False  # float32 means float32 in convolutions, too
        self.processes = count_processes(config) if device.type == "cpu" else 1
        self._loss, self._precision = loss, precision
        self._workers: list[SupervisedProcess] = []
        named = {f"target/{name}": spec for name, spec in targets.items()}
        if network.auxiliary_targets:
            shape = (config.rollout_steps, config.num_envs, network.auxiliary_targets)
            named["target/auxiliary"] = (shape, torch.float32)
        specs = {**rollout_specs(config.rollout_steps, config.num_envs, network.policy), **named}
        if self.processes > 1:
            self._share(specs, config.num_envs)
        else:
            self.rollout, self.targets = _buffers(zeros(specs, device))
            self.gradient = FlatParameters(network).gradient

    def _share(self, specs: TensorSpecs, num_envs: int) -> None:
        """Allocate what all processes read and write."""
        policy, shape = self.policy, self.policy.shape
        parameters = sum(p.numel() for p in self.network.parameters())
        shared: TensorSpecs = {
            "parameters": ((parameters,), torch.float32),
            "gradients": ((self.processes, parameters), torch.float32),
            "terms": ((self.processes, MAX_TERMS), torch.float32),
            "image": ((num_envs, shape.image_size, shape.image_size, 3), torch.uint8),
            "h": ((num_envs, policy.hidden_size), torch.float32),
            "c": ((num_envs, policy.hidden_size), torch.float32),
            "logits": ((num_envs, shape.joints, shape.levels), torch.float32),
        }
        self._context = process_context()
        self._shared = SharedTensors(self._context, {**specs, **shared})
        self.rollout, self.targets = _buffers(self._shared.tensors)
        self.gradient = self._shared["gradients"][0]
        self._shared["parameters"].copy_(FlatParameters(self.network).values)
        FlatParameters(self.network, self._shared["parameters"], self.gradient)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run the workers, and use one PyTorch thread per process, until the context ends."""
        with torch_threads(1):
            try:
                for index in range(1, self.processes):
                    self._workers.append(SupervisedProcess(partial(self._start, index)))
                yield
            finally:
                stop_all([worker.child for worker in self._workers])
                self._workers = []

    def infer(self, rollout: Rollout, t: int, image: Tensor, state: State) -> tuple[Tensor, State]:
        """Run the policy for step t, as `infer_step`; the next call may overwrite the state."""
        if self.processes == 1:
            return infer_step(self.policy, rollout, t, image, state)
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

    def compute_gradient(self, env_ids: Tensor) -> Terms:
        """Compute loss terms and gradient over the environments ``env_ids`` (b,) int64."""
        count = len(env_ids)
        own, *others = env_ids.chunk(self.processes)
        commands = [GradientCommand(part.numpy(), len(part) / count) for part in others]
        self._send(commands)
        self.gradient.zero_()
        arguments = self.network, self._loss, self.rollout, self.targets
        terms = add_gradient(*arguments, own, len(own) / count)
        self._wait(commands)
        for index in range(1, 1 + len(commands)):
            self.gradient += self._shared["gradients"][index]
            for term, part in zip(terms.values(), self._shared["terms"][index], strict=False):
                term.add_(part)
        return terms

    def _start(self, index: int, restarts: int) -> ChildProcess:
        network = self.network
        arguments = network.policy.maker(), network.auxiliary_targets, self._loss, self._precision
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


def count_processes(config: MinibatchConfig) -> int:
    """Return the number of processes: as configured, limited by the size of a minibatch."""
    most = config.num_envs // config.minibatches // MIN_ENVS_PER_PROCESS
    processes = max(1, min(config.processes or available_cores(), most))
    if config.processes is not None and processes < config.processes:
        log.warning(
            "processes=%d is reduced to %d: minibatches have %d environments, and each process "
            "needs %d of them.",
            config.processes,
            processes,
            config.num_envs // config.minibatches,
            MIN_ENVS_PER_PROCESS,
        )
    return processes
