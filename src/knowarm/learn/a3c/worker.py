"""A3C worker: process that collects rollouts and updates the shared parameters."""

import contextlib
import os
from multiprocessing.connection import Connection

import numpy as np
import torch

from knowarm.learn.a3c.messages import (
    A3CWorkerArgs,
    EvaluationRequest,
    SendState,
    TotalReached,
    TrainUntil,
    UpdateReport,
    WorkerState,
)
from knowarm.learn.a3c.shared_state import rmsprop_update
from knowarm.learn.collector import Collector
from knowarm.learn.config import A3CConfig
from knowarm.learn.curriculum import ThresholdCurriculum
from knowarm.learn.device import resolve_precision
from knowarm.learn.flat_parameters import FlatParameters
from knowarm.learn.guards import FiniteGuard
from knowarm.learn.losses import LossTerms, a3c_loss
from knowarm.learn.processes import ProcessFailure, prepare_child_process
from knowarm.learn.returns import advantages, n_step_returns
from knowarm.learn.rollout import Rollout, rollout_specs
from knowarm.learn.shared_tensors import SharedTensors, zeros
from knowarm.policy import Policy


def run_a3c_worker(args: A3CWorkerArgs, shared: SharedTensors, connection: Connection) -> None:
    """Entry point of a worker process: train until told to exit or the parent process exits."""
    prepare_child_process()
    try:
        A3CWorker(args, shared, connection).run()
    except (EOFError, BrokenPipeError, ConnectionResetError):
        os._exit(0)  # parent process exited
    except Exception as error:
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            connection.send(ProcessFailure.of(error))


class A3CWorker:
    """Repeatedly reads the shared parameters, collects a rollout, and updates them.

    Args:
        args: what to train on.
        shared: parameters and counters of all workers.
        connection: pipe to the trainer.
    """

    def __init__(self, args: A3CWorkerArgs, shared: SharedTensors, connection: Connection) -> None:
        self.args = args
        self.config = args.config
        self._shared = shared
        self._connection = connection
        self._policy = args.policy.build()
        self._policy.matmul_precision = resolve_precision(
            args.config.matmul_precision, torch.device("cpu")
        )
        self._parameters = FlatParameters(self._policy)
        env = args.make_env(self.config.envs_per_worker, 1)
        self._curriculum = ThresholdCurriculum(self.config, env)
        self._collector = Collector(
            env,
            self._policy,
            seed=args.seed,
            stream=(args.index, args.restarts),
            curriculum=self._curriculum,
        )
        if args.state is not None:
            self._collector.set_state(args.state)
        self._rollout = Rollout(
            **zeros(
                rollout_specs(self.config.rollout_steps, self.config.envs_per_worker, self._policy)
            )
        )
        self._guard = FiniteGuard(args.failure_folder)
        self._total_steps = 0

    def run(self) -> None:
        """Handle the trainer's messages and train between them."""
        while True:
            idle = self._total_reached()
            while self._connection.poll(None if idle else 0):
                message = self._connection.recv()
                if isinstance(message, TrainUntil):
                    self._total_steps = message.total_steps
                    idle = self._total_reached()
                    if idle:
                        self._connection.send(TotalReached())
                elif isinstance(message, SendState):
                    self._connection.send(self._state(message))
                    if message.then_exit:
                        return
            self._update()
            if self._total_reached():
                self._connection.send(TotalReached())

    def _total_reached(self) -> bool:
        return int(self._shared["steps"].sum()) >= self._total_steps

    def _update(self) -> None:
        """Collect one rollout and take one step of the shared optimizer."""
        config, shared = self.config, self._shared
        seen = int(shared["updates"].sum())
        self._parameters.values.copy_(shared["values"])
        rollout = self._rollout.first(
            self._collector.collect(
                self._rollout, until_episode_end=config.rollout_ends_with_episode
            )
        )
        steps = rollout.reward.numel()
        step = int(shared["steps"].sum()) + steps
        self._guard.check_rollout(rollout, self._policy.knowledge_table, step)
        loss = rollout_loss(self._policy, config, rollout)
        self._parameters.gradient.zero_()
        loss.total.backward()
        norm = self._parameters.clip_gradient(config.max_grad_norm)
        self._guard.check_update(self._policy, loss, norm, step, rollout)
        staleness = int(shared["updates"].sum()) - seen
        rmsprop_update(
            shared["values"],
            shared["mean_square"],
            self._parameters.gradient,
            learning_rate=config.learning_rate_at((step - steps) / self._total_steps),
            alpha=config.rmsprop_alpha,
            eps=config.rmsprop_eps,
        )
        shared["updates"][self.args.index] += 1
        shared["steps"][self.args.index] += steps
        episodes = self._collector.statistics.take()
        self._curriculum.update(episodes.summary().get("success", 0.0))
        self._connection.send(
            UpdateReport(
                steps=steps,
                staleness=staleness,
                policy_loss=float(loss.policy.detach()),
                value_loss=float(loss.value.detach()),
                entropy=float(loss.entropy.detach()),
                grad_norm=float(norm),
                threshold_factor=self._curriculum.factor,
                episodes=episodes,
            )
        )
        self._request_evaluation()

    def _request_evaluation(self) -> None:
        """Send the shared parameters if the steps have reached the next interim evaluation.

        Two workers may both send them; the trainer uses the first. Comparing with a shared counter
        instead of detecting a crossing ensures that none is missed.
        """
        if self.args.evaluate_every is None:
            return
        step = int(self._shared["steps"].sum())
        number = step // self.args.evaluate_every
        if number > int(self._shared["evaluated"][0]):
            self._shared["evaluated"][0] = number
            values = self._shared["values"].numpy().copy()
            self._connection.send(EvaluationRequest(number=number, step=step, values=values))

    def _state(self, request: SendState) -> WorkerState:
        shared, index = self._shared, self.args.index

        def copy(vector: torch.Tensor) -> np.ndarray | None:
            return vector.numpy().copy() if request.with_shared else None

        return WorkerState(
            number=request.number,
            collector=self._collector.get_state(),
            steps=int(shared["steps"][index]),
            updates=int(shared["updates"][index]),
            values=copy(shared["values"]),
            mean_square=copy(shared["mean_square"]),
        )


def rollout_loss(policy: Policy, config: A3CConfig, rollout: Rollout) -> LossTerms:
    """Compute A3C's loss over a rollout, with gradient.

    Args:
        policy: at the parameters that collected the rollout.
        config: discount, weights of the loss terms, and what ends a return.
        rollout: T steps of B environments.
    """
    reward = rollout.reward * config.reward_scale
    following = rollout.following(bootstrap_at_time_limit=config.bootstrap_at_time_limit)
    advantage = advantages(
        reward, rollout.value, following, rollout.done, config.gamma, config.gae_lambda
    )
    returns = n_step_returns(reward, following, rollout.done, config.gamma)
    logits, values, _ = policy.unroll(
        rollout.patches, rollout.facet, rollout.start_state, rollout.episode_start
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
