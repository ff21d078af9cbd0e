"""A3C on a fixed schedule: all workers in one process, their updates one after another."""

from collections import Counter
from typing import Any

import numpy as np
import torch
from torch import Tensor

from knowarm.cores import torch_threads
from knowarm.errors import UserError
from knowarm.learn.a3c.gradients import WorkerGradients
from knowarm.learn.a3c.messages import MakeEnv, mean_metrics, sums_of
from knowarm.learn.a3c.update import rmsprop_updates, rollout_loss
from knowarm.learn.algorithms import A3CConfig
from knowarm.learn.checkpoint import Checkpoint, policy_arrays, to_arrays
from knowarm.learn.environment import ThresholdCurriculum
from knowarm.learn.evaluation import Metrics
from knowarm.learn.guards import FiniteGuard
from knowarm.learn.losses import Terms
from knowarm.learn.optimizer import resolve_precision
from knowarm.learn.parallel.processes import keep_freed_memory
from knowarm.learn.parallel.shared_tensors import FlatParameters, parameter_views
from knowarm.learn.rollout import Collector
from knowarm.learn.trainer import StopReason, SynchronousTrainer
from knowarm.policy import Policy
from knowarm.seeding import derive_seed


class FixedScheduleA3CTrainer(SynchronousTrainer):
    """A3C (paper section 4.2.1) with one of the orders in which its workers could have updated.

    In every round all workers read the same parameters and play one rollout each; one that ends
    with the episode starts a new one, whose draws follow from seed and step. The gradient of
    each is computed at these parameters, and the updates are applied one after another, that of the
    shortest rollout first, each clipped by itself. A gradient is at most ``workers - 1`` updates
    old. One process plays and learns for all workers, and a training repeats to the byte.

    Args:
        config: the algorithm's configuration, with one environment per worker.
        policy: trained in place; holds the result after `train`.
        make_env: creates the environments of all workers, on the CPU.
        options: as `Trainer`; with streams of ``seed`` for episodes and actions.
    """

    def __init__(
        self,
        config: A3CConfig,
        policy: Policy,
        make_env: MakeEnv,
        **options: Any,
    ) -> None:
        super().__init__(policy, **options)
        self.config = config
        cpu = torch.device("cpu")
        self._precision = resolve_precision(config.matmul_precision, cpu)
        self._mean_square = torch.zeros_like(FlatParameters(policy).values)
        workers = config.workers
        with torch_threads(1), policy.computing(self._precision):
            self._workers = WorkerGradients(policy, config.rollout_steps, workers)
        env = make_env(workers, 1)
        self._curriculum = ThresholdCurriculum(config, env)
        self._collector = Collector(env, policy, seed=self.seed)
        self._guard = FiniteGuard(self.failure_folder)

    def _train(self, total_steps: int) -> StopReason:
        keep_freed_memory()
        with torch_threads(1), self.policy.computing(self._precision):
            return super()._train(total_steps)

    def update(self, total_steps: int) -> Metrics:
        """Play and learn for `A3CConfig.log_every_steps`; see `SynchronousTrainer.update`."""
        end = min(total_steps, self.step + self.config.log_every_steps)
        sums: Counter[str] = Counter()
        while self.step < end:
            sums.update(self._round(total_steps))
        return mean_metrics(sums)

    def _round(self, total_steps: int) -> dict[str, float]:
        """Play one rollout per worker and apply their updates; return sums over the workers."""
        config = self.config
        workers = self._workers
        collector = self._collector
        whole = config.rollout_ends_with_episode
        if whole:
            # By the step, so that a checkpoint between two rounds needs no environments.
            collector.restart(derive_seed(self.seed, "episodes", self.step))
        count = collector.collect(
            workers.rollout, workers.infer, until_episode_end=whole
        )
        rollout = workers.rollout.first(count)
        used = first_episodes(rollout.done) if whole else torch.ones_like(rollout.done)
        lengths = used.sum(0)
        episodes = collector.statistics.take(used)
        if whole and len(episodes.length) < config.workers:
            raise UserError(
                f"rollout_steps is {config.rollout_steps}, and an episode has not ended then: let "
                "rollouts have at least the steps of an episode, or set rollout_ends_with_episode "
                "to False."
            )
        after = self.step + int(lengths.sum())
        self._guard.check_rollout(rollout, after)

        def loss_of(encoded: Tensor) -> Terms:
            weights = used / lengths
            return rollout_loss(
                self.policy, config, rollout, encoded=encoded, weights=weights
            )

        loss = workers.compute(count, loss_of)
        of_layers = [
            torch.linalg.vector_norm(gradient.flatten(1), dim=1)
            for gradient in workers.gradients.values()
        ]
        norms = torch.linalg.vector_norm(torch.stack(of_layers), dim=0)
        self._guard.check_update(self.policy, loss, norms, after, rollout)
        self._apply(lengths, norms, total_steps)
        self._curriculum.update(
            episodes.summary().get("success", 0.0), after / total_steps
        )
        return {
            "updates": config.workers,
            **sums_of(episodes, loss),
            "grad_norm": float(norms.sum()),
            "threshold_factor": self._curriculum.factor * config.workers,
        }

    def _apply(self, lengths: Tensor, norms: Tensor, total_steps: int) -> None:
        """Apply the updates of all workers, and count their steps (W,)."""
        config = self.config
        order = torch.argsort(lengths, stable=True)
        rates = np.empty(config.workers, np.float32)
        step = self.step
        for worker in order.tolist():
            rates[worker] = config.learning_rate_at(step / total_steps)
            step += int(lengths[worker])
        factors = (config.max_grad_norm / norms).clamp(max=1).numpy()
        mean_squares = parameter_views(self.policy, self._mean_square)
        for name, parameter in self.policy.named_parameters():
            rmsprop_updates(
                parameter.detach().flatten().numpy(),
                mean_squares[name].flatten().numpy(),
                self._workers.gradients[name].flatten(1).numpy(),
                order.numpy(),
                factors,
                rates,
                np.float32(config.rmsprop_eps),
            )
        self.step = step

    def checkpoint(self) -> Checkpoint:
        """See `SynchronousTrainer.checkpoint`."""
        collector = self._collector
        if self.config.rollout_ends_with_episode:
            state = to_arrays({"generator": collector.generator.get_state()})
        else:
            state = collector.get_state()
        return Checkpoint(
            policy=policy_arrays(self.policy),
            optimizer=to_arrays({"mean_square": self._mean_square}),
            state=state | self._curriculum.get_state(),
        )

    def restore(self, checkpoint: Checkpoint) -> None:
        """See `Trainer.restore`."""
        state = checkpoint.state
        self._mean_square.copy_(torch.from_numpy(checkpoint.optimizer["mean_square"]))
        if self.config.rollout_ends_with_episode:
            self._collector.generator.set_state(torch.tensor(state["generator"]))
        else:
            self._collector.set_state(state)
        self._curriculum.set_state(state)


def first_episodes(done: Tensor) -> Tensor:
    """Tell which steps (T, B) belong to the first episode of their environment."""
    return done.cumsum(0) == done.int()
