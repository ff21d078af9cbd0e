"""Shared parameters and own environments go in; updates of the shared parameters come out."""

import contextlib
import os
import traceback
from multiprocessing.connection import Connection

import numpy as np
import torch

from knowarm.errors import UserError
from knowarm.learn.a3c.messages import (
    Failure,
    Finished,
    Record,
    SendState,
    Train,
    WorkerJob,
    WorkerState,
)
from knowarm.learn.a3c.rmsprop import rmsprop_update
from knowarm.learn.a3c.shared import SharedLearning
from knowarm.learn.collector import Collector
from knowarm.learn.evaluator import Snapshot
from knowarm.learn.flat import FlatParameters
from knowarm.learn.guards import FiniteGuard, NotFiniteError
from knowarm.learn.losses import LossTerms, a3c_loss
from knowarm.learn.player import SoloPlayer
from knowarm.learn.precision import resolve_precision
from knowarm.learn.processes import prepare_process
from knowarm.learn.returns import advantages, n_step_returns
from knowarm.learn.rollout import Rollout, rollout_shapes
from knowarm.policy import Policy


def run_worker(job: WorkerJob, shared: SharedLearning, connection: Connection) -> None:
    """Entry point of a worker process: work until told to end or until the trainer is gone."""
    prepare_process()
    try:
        Worker(job, shared, connection).run()
    except (EOFError, BrokenPipeError, ConnectionResetError):
        # The trainer is gone: nobody is left to work for.
        os._exit(0)
    except Exception as error:
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            connection.send(_failure(error))


class Worker:
    """Reads the shared parameters, plays, computes a gradient, updates them, again and again."""

    def __init__(self, job: WorkerJob, shared: SharedLearning, connection: Connection) -> None:
        self.job = job
        self.config = job.config
        self._shared = shared
        self._connection = connection
        self._policy = Policy(job.policy)
        self._policy.matmul_precision = resolve_precision(
            job.config.matmul_precision, torch.device("cpu")
        )
        self._flat = FlatParameters(self._policy)
        self._table = torch.tensor(job.table, dtype=torch.float32)
        env = job.make_env(self.config.envs_per_worker, 1)
        self._collector = Collector(env, self._policy, self._table, seed=job.seed)
        if job.state is not None:
            self._collector.set_state(job.state)
        self._rollout = Rollout.zeros(
            rollout_shapes(self.config.rollout_steps, self.config.envs_per_worker, self._policy)
        )
        self._player = SoloPlayer(self._policy, self._table)
        self._guard = FiniteGuard(job.failure_folder)
        self._total_steps = 0

    def run(self) -> None:
        """Obey the trainer's messages; between them, train."""
        while True:
            idle = int(self._shared.steps.sum()) >= self._total_steps
            while self._connection.poll(None if idle else 0):
                message = self._connection.recv()
                if isinstance(message, Train):
                    self._total_steps = message.total_steps
                    idle = int(self._shared.steps.sum()) >= self._total_steps
                    if idle:
                        self._connection.send(Finished())
                elif isinstance(message, SendState):
                    self._connection.send(self._state(message.leader))
                    if message.then_end:
                        return
            self._update()
            if int(self._shared.steps.sum()) >= self._total_steps:
                self._connection.send(Finished())

    def _update(self) -> None:
        """One rollout and one step of the shared optimizer."""
        config, shared, rollout = self.config, self._shared, self._rollout
        seen = int(shared.updates.sum())
        self._flat.values.copy_(shared.values)
        self._collector.collect(self._player, rollout)
        steps = rollout.reward.numel()
        self._guard.check_rollout(rollout, self._table, int(shared.steps.sum()) + steps)
        loss = self._loss()
        self._flat.gradient.zero_()
        loss.total.backward()
        norm = self._flat.clip_gradient(config.max_grad_norm)
        self._guard.check_update(self._policy, loss, norm, int(shared.steps.sum()) + steps, rollout)
        staleness = int(shared.updates.sum()) - seen
        rmsprop_update(
            shared.values,
            shared.mean_square,
            self._flat.gradient,
            learning_rate=config.learning_rate,
            decay=config.rmsprop_decay,
            epsilon=config.rmsprop_epsilon,
        )
        shared.updates[self.job.index] += 1
        shared.steps[self.job.index] += steps
        self._connection.send(
            Record(
                steps=steps,
                staleness=staleness,
                policy_loss=float(loss.policy.detach()),
                value_loss=float(loss.value.detach()),
                entropy=float(loss.entropy.detach()),
                grad_norm=float(norm),
                episodes=self._collector.statistics.take(),
            )
        )
        self._ask_for_evaluation()

    def _loss(self) -> LossTerms:
        config, rollout = self.config, self._rollout
        reward = rollout.reward * config.reward_scale
        following = rollout.following()
        advantage = advantages(
            reward, rollout.value, following, rollout.done, config.gamma, config.gae_lambda
        )
        returns = n_step_returns(reward, following, rollout.done, config.gamma)
        logits, values, _ = self._policy.unroll(
            rollout.patches,
            self._table[rollout.facet],
            rollout.start_state,
            rollout.episode_start,
        )
        return a3c_loss(
            logits,
            values,
            rollout.action,
            advantage,
            returns,
            vf_coef=config.vf_coef,
            ent_coef=config.ent_coef,
        )

    def _ask_for_evaluation(self) -> None:
        """Send the shared parameters if the steps have reached the next interim evaluation.

        Two workers may both ask; the trainer takes the first. Comparing with a shared number
        instead of looking for a crossing means that none is missed.
        """
        if self.job.evaluate_every is None:
            return
        step = int(self._shared.steps.sum())
        number = step // self.job.evaluate_every
        if number > int(self._shared.evaluated[0]):
            self._shared.evaluated[0] = number
            values = self._shared.values.numpy().copy()
            self._connection.send(Snapshot(number=number, step=step, values=values))

    def _state(self, leader: bool) -> WorkerState:
        shared, index = self._shared, self.job.index

        def copy(vector: torch.Tensor) -> np.ndarray | None:
            return vector.numpy().copy() if leader else None

        return WorkerState(
            state=self._collector.get_state(),
            steps=int(shared.steps[index]),
            updates=int(shared.updates[index]),
            values=copy(shared.values),
            mean_square=copy(shared.mean_square),
        )


def _failure(error: Exception) -> Failure:
    lines = traceback.format_exception(error)
    not_finite = None
    if isinstance(error, NotFiniteError):
        not_finite = (error.term, error.step, error.batch)
    return Failure(
        error=lines[-1].strip(),
        traceback="".join(lines),
        not_finite=not_finite,
        user_error=str(error) if isinstance(error, UserError) else None,
    )
