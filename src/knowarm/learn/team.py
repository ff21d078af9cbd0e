"""A policy and a number of processes go in; rollouts and gradients they share the work of come out.

PyTorch's threads share every single operation. The operations of a recurrent policy are many and
small: two threads wait for one another, and spin while they wait, which takes time from physics and
images too; threads of Python wait for the interpreter's lock. Processes that each take a part of
the environments through the whole network do neither (docs/lab-notes.md).
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

from knowarm.learn.config import PPOConfig
from knowarm.learn.flat import FlatParameters
from knowarm.learn.helper import (
    Failure,
    HelperJob,
    Learn,
    Play,
    run_helper,
    shared_shapes,
    write_play,
)
from knowarm.learn.losses import PPOLossTerms
from knowarm.learn.minibatch import Targets, differentiate, target_shapes
from knowarm.learn.processes import Child, process_context
from knowarm.learn.rollout import Rollout, rollout_shapes
from knowarm.learn.shared import SharedTensors
from knowarm.policy import Policy
from knowarm.policy.memory import State
from knowarm.policy.policy import MatmulPrecision

log = logging.getLogger("knowarm.learn")

GIVE_UP_AFTER = 3
"""Helpers that may die before training stops."""


class Team:
    """The trainer's process and helpers, which share parameters, rollout and targets in memory.

    Helpers remember nothing between two commands, so one that dies is replaced and nothing is
    lost. Sums are taken in another order than one process would, always the same one for a number
    of processes. See `Learner`.

    Args:
        policy: the trainer's; its parameters move to shared memory.
        config: sizes of the rollout, weights of the loss.
        table: (F, K) float32 knowledge, one row a facet.
        precision: of the products in encoder and memory.
        processes: how many work side by side, this one included; at least 2.
    """

    def __init__(
        self,
        policy: Policy,
        config: PPOConfig,
        table: np.ndarray,
        precision: MatmulPrecision,
        processes: int,
    ) -> None:
        assert processes > 1, processes
        self.policy = policy
        self._config = config
        self._table = torch.tensor(table, dtype=torch.float32)
        self.processes = processes
        self._context = process_context(["knowarm.learn.helper"])
        self._job = HelperJob(policy.config, config, table, precision)
        shapes = shared_shapes(policy, config, self.processes)
        self._shared = SharedTensors(self._context, shapes)
        self._shared["parameters"].copy_(FlatParameters(policy).values)
        self.gradient = self._shared["gradients"][0]
        FlatParameters.at(policy, self._shared["parameters"], self.gradient)
        steps, count = config.rollout_steps, config.num_envs
        self.rollout = Rollout(**self._shared.of(rollout_shapes(steps, count, policy)))
        self.targets = Targets(**self._shared.of(target_shapes(steps, count)))
        self._helpers: list[Child] = []
        self._deaths = 0

    @contextmanager
    def at_work(self) -> Iterator[None]:
        """Have the helpers running, and PyTorch keep to one thread a process."""
        before = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            self._helpers = [self._start(index) for index in range(1, self.processes)]
            yield
        finally:
            for helper in self._helpers:
                helper.end()
            self._helpers = []
            torch.set_num_threads(before)

    def play(self, rollout: Rollout, t: int, image: Tensor, state: State) -> tuple[Tensor, State]:
        """As `Learner.play`."""
        shared = self._shared
        cuts = [len(image) * i // self.processes for i in range(self.processes + 1)]
        own, *others = map(slice, cuts, cuts[1:])
        shared["image"][own.stop :] = image[own.stop :]
        if state[0] is not shared["h"]:
            shared["h"].copy_(state[0])
            shared["c"].copy_(state[1])
        commands = [Play(t, rows) for rows in others]
        self._send(commands)
        write_play(self.policy, self._table, rollout, shared, t, image, own)
        self._await(commands)
        return shared["logits"].clone(), (shared["h"], shared["c"])

    def differentiate(self, columns: Tensor) -> PPOLossTerms:
        """As `Learner.differentiate`."""
        own, *others = columns.chunk(self.processes)
        commands = [Learn(part.numpy(), len(part) / len(columns)) for part in others]
        self._send(commands)
        self.gradient.zero_()
        terms = differentiate(
            self.policy,
            self._config,
            self._table,
            self.rollout,
            self.targets,
            own,
            len(own) / len(columns),
        )
        self._await(commands)
        for index in range(1, 1 + len(commands)):
            self.gradient += self._shared["gradients"][index]
            terms = terms + PPOLossTerms.from_vector(self._shared["terms"][index])
        return terms

    def _start(self, index: int) -> Child:
        name = f"learning helper {index}"
        return Child.start(self._context, name, run_helper, self._job, index, self._shared)

    def _send(self, commands: "list[Play] | list[Learn]") -> None:
        for helper, command in zip(self._helpers, commands, strict=False):
            helper.send(command)

    def _await(self, commands: "list[Play] | list[Learn]") -> None:
        """Wait until every helper has done its command; one that dies is replaced.

        Raises:
            RuntimeError: a helper failed, with its traceback, or they die again and again.
        """
        for index, command in enumerate(commands):
            while True:
                helper = self._helpers[index]
                try:
                    answer = helper.connection.recv()
                except (EOFError, ConnectionResetError):
                    self._replace(index)
                    self._helpers[index].send(command)
                    continue
                if isinstance(answer, Failure):
                    raise RuntimeError(f"The {helper.name} failed.\n{answer.traceback}")
                break

    def _replace(self, index: int) -> None:
        dead = self._helpers[index]
        ending = dead.how_it_ended()
        dead.end()
        self._deaths += 1
        if self._deaths >= GIVE_UP_AFTER:
            raise RuntimeError(
                f"The {dead.name} {ending}, again and again. A script that trains needs the usual "
                '`if __name__ == "__main__":` around what it does; processes=1 needs no helpers.'
            )
        log.warning("The %s %s; another takes its place.", dead.name, ending)
        self._helpers[index] = self._start(index + 1)
