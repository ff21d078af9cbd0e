"""Learner: the network in training, its inference and gradients, in one process or several.

PyTorch's threads share every single operation, of which a recurrent policy has many small ones:
threads synchronize after each and take time from physics and rendering by spinning. Processes that
each compute the entire network for a part of the environments avoid this (docs/lab-notes.md).
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from knowarm.cores import available_cores, torch_threads
from knowarm.learn.algorithms import MinibatchConfig
from knowarm.learn.losses import Terms
from knowarm.learn.parallel.processes import (
    ChildProcess,
    Restarted,
    SupervisedProcess,
    process_context,
    stop_all,
)
from knowarm.learn.parallel.shared_tensors import (
    FlatParameters,
    SharedTensors,
    TensorSpecs,
    zeros,
)
from knowarm.learn.rollout import Rollout, infer_step, rollout_specs
from knowarm.policy import MakePolicy, MatmulPrecision, Policy, State
from knowarm.policy.encoder import orthogonal
from knowarm.seeding import torch_generator

log = logging.getLogger("knowarm.learn")

MIN_ENVS_PER_PROCESS = 8
"""Smallest number of a minibatch's environments that is worth another process."""

MAX_TERMS = 8
"""Most terms of a loss."""


Targets = Mapping[str, Tensor]
"""What a loss compares a rollout with, by name, each (T, B, ...)."""


class TrainingNetwork(nn.Module):
    """The policy, and in training only a head that predicts K auxiliary targets (0: no head)."""

    def __init__(
        self,
        policy: Policy,
        auxiliary_targets: int = 0,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.policy = policy
        self.auxiliary_targets = auxiliary_targets
        self.head: nn.Linear | None = None
        if auxiliary_targets:
            self.head = nn.Linear(policy.fc.out_features, auxiliary_targets)
            orthogonal(self.head, 1.0, torch_generator(seed, "weights", 2))
            self.head.to(policy.fc.weight.device)

    def parameters_by_name(self) -> dict[str, nn.Parameter]:
        """Return the parameters by name, those of the head after ``auxiliary``."""
        parameters = dict(self.policy.named_parameters())
        if self.head is not None:
            parameters |= dict(self.head.named_parameters("auxiliary"))
        return parameters

    def forward(self, batch: Rollout) -> tuple[Tensor, Tensor, Tensor]:
        """Return logits (T, b, J, A), values (T, b) and image features (T * b, F) of a rollout."""
        logits, values, _, features = self.policy.unroll_with_features(
            batch.patches, batch.knowledge, batch.start_state, batch.episode_start
        )
        return logits, values, features

    def add_auxiliary(
        self,
        terms: Terms,
        features: Tensor,
        targets: Targets,
        coefficient: float,
    ) -> Terms:
        """Add the mean squared error of the head, if there is one, to the terms of a loss."""
        if self.head is None:
            return terms
        error = self.head(features.float()) - targets["auxiliary"].flatten(0, 1)
        auxiliary = error.square().mean()
        total = terms["total"] + coefficient * auxiliary
        return {**terms, "total": total, "auxiliary_loss": auxiliary}


Loss = Callable[[TrainingNetwork, Rollout, Targets], Terms]
"""Computes the terms of an algorithm's loss over a minibatch; picklable."""


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
    that the returned terms of the processes add up to those of the minibatch.
    """
    selected = {
        name: target.index_select(1, env_ids) for name, target in targets.items()
    }
    terms = loss(network, rollout.of(env_ids), selected)
    (terms["total"] * weight).backward()
    return {name: term.detach() * weight for name, term in terms.items()}


class SharedBuffers(NamedTuple):
    """What the processes of a learner read and write."""

    rollout: SharedTensors
    targets: SharedTensors
    exchange: SharedTensors
    """Parameters and gradients; images, recurrent states and logits of one step."""


class InferCommand(NamedTuple):
    """To a worker: run the policy for step ``t`` of the environments ``envs``."""

    t: int
    envs: slice


class GradientCommand(NamedTuple):
    """To a worker: compute the gradient over ``env_ids``, weighted; see `add_gradient`."""

    env_ids: np.ndarray
    weight: float


def infer_shared(
    policy: Policy,
    rollout: Rollout,
    exchange: SharedTensors,
    t: int,
    image: Tensor,
    envs: slice,
) -> None:
    """Run the policy for step t of ``envs``; recurrent states and logits are shared tensors."""
    state = (exchange["h"], exchange["c"])
    logits, (h, c) = infer_step(policy, rollout, t, image, state, envs)
    exchange["logits"][envs] = logits
    exchange["h"][envs] = h
    exchange["c"][envs] = c


def run_learner_worker(
    make_policy: MakePolicy,
    auxiliary_targets: int,
    loss: Loss,
    precision: MatmulPrecision,
    shared: SharedBuffers,
    index: int,
    connection: Connection,
) -> None:
    """Entry point of a learner worker: execute commands until the parent process exits.

    Every command is answered with true once its results are in shared memory.
    """
    policy = make_policy()
    policy.matmul_precision = precision
    network = TrainingNetwork(policy, auxiliary_targets)
    rollout = Rollout(**shared.rollout.tensors)
    targets = shared.targets.tensors
    exchange = shared.exchange
    gradient = exchange["gradients"][index]
    FlatParameters(network, exchange["parameters"], gradient)
    while True:
        command = connection.recv()
        if isinstance(command, InferCommand):
            infer_shared(
                policy, rollout, exchange, command.t, exchange["image"], command.envs
            )
        else:
            gradient.zero_()
            env_ids = torch.from_numpy(command.env_ids)
            terms = add_gradient(
                network, loss, rollout, targets, env_ids, command.weight
            )
            exchange["terms"][index, : len(terms)] = torch.stack([*terms.values()])
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
        # float32 means float32 in convolutions, too.
        torch.backends.cudnn.allow_tf32 = False
        self.processes = count_processes(config) if device.type == "cpu" else 1
        self._loss = loss
        self._precision = precision
        self._workers: list[SupervisedProcess] = []
        table = (config.rollout_steps, config.num_envs)
        rollout = rollout_specs(*table, network.policy)
        if network.auxiliary_targets:
            shape = (*table, network.auxiliary_targets)
            targets = {**targets, "auxiliary": (shape, torch.float32)}
        if self.processes > 1:
            self._share(rollout, targets, config.num_envs)
        else:
            self.rollout = Rollout(**zeros(rollout, device))
            self.targets = zeros(targets, device)
            self.gradient = FlatParameters(network).gradient

    def _share(self, rollout: TensorSpecs, targets: TensorSpecs, num_envs: int) -> None:
        """Allocate what all processes read and write."""
        shape = self.policy.shape
        flat = FlatParameters(self.network)
        count = len(flat.values)
        state = ((num_envs, self.policy.hidden_size), torch.float32)
        specs: TensorSpecs = {
            "parameters": ((count,), torch.float32),
            "gradients": ((self.processes, count), torch.float32),
            "terms": ((self.processes, MAX_TERMS), torch.float32),
            "image": ((num_envs, shape.image_size, shape.image_size, 3), torch.uint8),
            "h": state,
            "c": state,
            "logits": ((num_envs, shape.joints, shape.levels), torch.float32),
        }
        self._context = process_context()
        shared = partial(SharedTensors, self._context)
        exchange = shared(specs)
        self._shared = SharedBuffers(shared(rollout), shared(targets), exchange)
        self.rollout = Rollout(**self._shared.rollout.tensors)
        self.targets = self._shared.targets.tensors
        self.gradient = exchange["gradients"][0]
        parameters = exchange["parameters"]
        parameters.copy_(flat.values)
        FlatParameters(self.network, parameters, self.gradient)

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

    def infer(
        self,
        rollout: Rollout,
        t: int,
        image: Tensor,
        state: State,
    ) -> tuple[Tensor, State]:
        """Run the policy for step t, as `infer_step`; the next call may overwrite the state."""
        if self.processes == 1:
            return infer_step(self.policy, rollout, t, image, state)
        exchange = self._shared.exchange
        bounds = [len(image) * i // self.processes for i in range(self.processes + 1)]
        # This process computes the first slice, from the images as they are.
        first, *others = map(slice, bounds, bounds[1:])
        exchange["image"][first.stop :] = image[first.stop :]
        # After the first step the state is what the processes wrote themselves.
        if state[0] is not exchange["h"]:
            exchange["h"].copy_(state[0])
            exchange["c"].copy_(state[1])
        with self._executing([InferCommand(t, envs) for envs in others]):
            infer_shared(self.policy, rollout, exchange, t, image, first)
        return exchange["logits"].clone(), (exchange["h"], exchange["c"])

    def compute_gradient(self, env_ids: Tensor) -> Terms:
        """Compute loss terms and gradient over the environments ``env_ids`` (b,) int64."""
        count = len(env_ids)
        first, *others = env_ids.chunk(self.processes)
        commands = [
            GradientCommand(chunk.numpy(), len(chunk) / count) for chunk in others
        ]
        weight = len(first) / count
        self.gradient.zero_()
        with self._executing(commands):
            terms = add_gradient(
                self.network, self._loss, self.rollout, self.targets, first, weight
            )
        # A small minibatch may have fewer chunks than there are processes.
        for index, _ in enumerate(commands, 1):
            exchange = self._shared.exchange
            self.gradient += exchange["gradients"][index]
            of_worker = exchange["terms"][index, : len(terms)]
            for term, other in zip(terms.values(), of_worker, strict=True):
                term.add_(other)
        return terms

    def _start(self, index: int, restarts: int) -> ChildProcess:
        return ChildProcess.start(
            self._context,
            f"learner worker {index}",
            run_learner_worker,
            self.policy.maker(),
            self.network.auxiliary_targets,
            self._loss,
            self._precision,
            self._shared,
            index,
        )

    @contextmanager
    def _executing(
        self, commands: Sequence[InferCommand | GradientCommand]
    ) -> Iterator[None]:
        """Let workers execute a command each meanwhile; a restarted one executes it again."""
        for worker, command in zip(self._workers, commands, strict=False):
            worker.child.send(command)
        yield
        for worker, command in zip(self._workers, commands, strict=False):
            while isinstance(worker.receive(), Restarted):
                worker.child.send(command)


def count_processes(config: MinibatchConfig) -> int:
    """Return the number of processes: as configured, limited by the size of a minibatch."""
    minibatch = config.num_envs // config.minibatches
    most = max(1, minibatch // MIN_ENVS_PER_PROCESS)
    processes = min(config.processes or available_cores(), most)
    if config.processes is not None and processes < config.processes:
        log.warning(
            "processes=%d is reduced to %d: minibatches have %d environments, and each process "
            "needs %d of them.",
            config.processes,
            processes,
            minibatch,
            MIN_ENVS_PER_PROCESS,
        )
    return processes
