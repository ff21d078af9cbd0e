"""A3C worker: process that collects rollouts and updates the shared parameters."""

from multiprocessing.connection import Connection

import torch

from knowarm.learn.a3c.messages import (
    A3CWorkerArgs,
    EvaluationRequest,
    StateRequest,
    UpdateReport,
    WorkerState,
    copy_vectors,
    sums_of,
)
from knowarm.learn.a3c.update import rmsprop_update, rollout_loss
from knowarm.learn.environment import ThresholdCurriculum
from knowarm.learn.guards import FiniteGuard
from knowarm.learn.optimizer import resolve_precision
from knowarm.learn.parallel.shared_tensors import (
    FlatParameters,
    SharedTensors,
    clip_gradient,
)
from knowarm.learn.rollout import Collector, Rollout

IDLE_S = 0.05
"""Time between two looks of a paused worker at whether training continues [s]."""


class A3CWorker:
    """Repeatedly reads the shared parameters, collects a rollout, and updates them."""

    def __init__(
        self,
        args: A3CWorkerArgs,
        shared: SharedTensors,
        connection: Connection,
    ) -> None:
        config = args.config
        self.args = args
        self.config = config
        self._shared = shared
        self._connection = connection
        self._policy = args.make_policy()
        precision = resolve_precision(config.matmul_precision, torch.device("cpu"))
        self._policy.matmul_precision = precision
        self._parameters = FlatParameters(self._policy)
        env = args.make_env(config.envs_per_worker, 1)
        self._curriculum = ThresholdCurriculum(config, env)
        stream = (args.index, args.restarts)
        self._collector = Collector(env, self._policy, seed=args.seed, stream=stream)
        if args.state is not None:
            self._collector.set_state(args.state)
            self._curriculum.set_state(args.state)
        elif args.threshold_factor is not None and self._curriculum.is_used:
            self._curriculum.factor = args.threshold_factor
        self._rollout = Rollout.zeros(
            config.rollout_steps, config.envs_per_worker, self._policy
        )
        self._guard = FiniteGuard(args.failure_folder)

    def run(self) -> None:
        """Answer the trainer's requests and train between them."""
        while True:
            is_done = self._step() >= self.args.total_steps
            is_idle = is_done or bool(self._shared["paused"])
            if self._connection.poll(IDLE_S if is_idle else 0):
                request: StateRequest = self._connection.recv()
                self._connection.send(self._state(request))
                if request.is_last:
                    return
            elif not is_idle:
                self._connection.send(self._update())

    def _step(self) -> int:
        """Return the environment steps of all workers."""
        return int(self._shared["steps"].sum())

    def _update(self) -> UpdateReport:
        """Collect one rollout and take one step of the shared optimizer."""
        args = self.args
        config = self.config
        shared = self._shared
        parameters = self._parameters
        parameters.values.copy_(shared["values"])
        ends = config.rollout_ends_with_episode
        count = self._collector.collect(self._rollout, until_episode_end=ends)
        rollout = self._rollout.first(count)
        steps = rollout.reward.numel()
        before = self._step()
        after = before + steps
        self._guard.check_rollout(rollout, after)
        loss = rollout_loss(self._policy, config, rollout)
        parameters.gradient.zero_()
        loss["total"].backward()
        norm = clip_gradient(parameters.gradient, config.max_grad_norm)
        self._guard.check_update(self._policy, loss, norm, after, rollout)
        rmsprop_update(
            shared["values"],
            shared["mean_square"],
            parameters.gradient,
            learning_rate=config.learning_rate_at(before / args.total_steps),
            eps=config.rmsprop_eps,
        )
        shared["steps"][args.index] += steps
        episodes = self._collector.statistics.take()
        success = episodes.summary().get("success", 0.0)
        self._curriculum.update(success, after / args.total_steps)
        sums = {
            "updates": 1,
            "steps": steps,
            **sums_of(episodes, loss),
            "grad_norm": float(norm),
            "threshold_factor": self._curriculum.factor,
        }
        return UpdateReport(sums=sums, evaluation=self._due_evaluation())

    def _due_evaluation(self) -> EvaluationRequest | None:
        """Return the shared parameters if the steps have reached the next interim evaluation.

        Two workers may both send them; the trainer uses the first. Comparing with a shared counter
        instead of detecting a crossing ensures that none is missed.
        """
        if self.args.evaluate_every is None:
            return None
        step = self._step()
        number = step // self.args.evaluate_every
        if number <= int(self._shared["evaluated"]):
            return None
        self._shared["evaluated"].fill_(number)
        return EvaluationRequest(step, self._shared.copy("values"))

    def _state(self, request: StateRequest) -> WorkerState:
        index = self.args.index
        return WorkerState(
            is_last=request.is_last,
            collector=self._collector.get_state() | self._curriculum.get_state(),
            steps=int(self._shared["steps"][index]),
            vectors={} if index > 0 else copy_vectors(self._shared),
        )


def run_a3c_worker(
    args: A3CWorkerArgs,
    shared: SharedTensors,
    connection: Connection,
) -> None:
    """Entry point of a worker process: train until the last state is requested."""
    A3CWorker(args, shared, connection).run()
