"""Imitation: the policy acts, and a teacher labels every state that it visits (DAgger)."""

from functools import partial
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor

from knowarm.errors import UserError
from knowarm.learn.algorithms import SHORTEST_WAY, DistilConfig
from knowarm.learn.checkpoint import Checkpoint
from knowarm.learn.environment import TeachingVectorEnv, TorchVectorEnv
from knowarm.learn.evaluation import Metrics
from knowarm.learn.learner import Targets, TrainingNetwork
from knowarm.learn.losses import Terms, distil_loss
from knowarm.learn.parallel.shared_tensors import flatten_parameters
from knowarm.learn.ppo import MinibatchTrainer
from knowarm.learn.privileged import PrivilegedRecorder
from knowarm.learn.rollout import Rollout
from knowarm.policy import Policy

AVERAGE_UPDATES = 15
"""Number of updates over which the parameters are averaged (exponentially) for interim evaluations
and the best policy, which act with the averages."""
WAY_SCALE = 10.0
"""Way to the teacher's solution that is one unit of the auxiliary loss [largest steps]."""
WAY_BOUND = 2.0


class LessonRecorder(PrivilegedRecorder):
    """Records the teacher's answers, too.

    Attributes:
        actions: (T, B, J) int64, what the teacher would do instead of each step.
        way: (T, B, J) float32, way to its solution before each step [largest steps].
    """

    def __init__(self, env: TorchVectorEnv, steps: int) -> None:
        super().__init__(env, steps)
        if not hasattr(env, "teach"):
            raise UserError(
                f"{type(env).__name__} has no teacher, which imitation needs: implement "
                "knowarm.learn.TeachingVectorEnv, or choose another algorithm."
            )
        self.teaching = cast(TeachingVectorEnv, env)
        actions, way = self.teaching.teach()
        self.actions = actions.repeat(steps, 1, 1)
        self.way = way.repeat(steps, 1, 1)

    @property
    def auxiliary_targets(self) -> int:
        """Number of targets of the auxiliary head, with the way of every joint."""
        return super().auxiliary_targets + self.way.shape[-1]

    def before_step(self, t: int) -> None:
        """Record the state before step t, and what the teacher would do."""
        super().before_step(t)
        actions, way = self.teaching.teach()
        self.actions[t] = actions
        self.way[t] = way

    def targets(self) -> Tensor:
        """Return the targets of the auxiliary head, (T, B, K), with the way to the solution."""
        way = (self.way / WAY_SCALE).clamp(-WAY_BOUND, WAY_BOUND)
        return torch.cat((super().targets(), way), -1)


def minibatch_loss(
    config: DistilConfig,
    network: TrainingNetwork,
    batch: Rollout,
    targets: Targets,
) -> Terms:
    """Compute the loss of imitation, and the auxiliary one, over a minibatch."""
    logits, _, features = network(batch)
    loss = distil_loss(
        logits, targets["actions"], targets["weights"], config.stay_share
    )
    terms = {"total": loss, "imitation_loss": loss}
    return network.add_auxiliary(terms, features, targets, config.auxiliary_coef)


class DistilTrainer(MinibatchTrainer):
    """Imitation of a teacher by the cross-entropy to its actions; see `MinibatchTrainer`."""

    config: DistilConfig

    def __init__(
        self,
        config: DistilConfig,
        policy: Policy,
        env: TorchVectorEnv,
        **options: Any,
    ) -> None:
        lessons = LessonRecorder(env, config.rollout_steps)
        lessons.teaching.practice_share = config.practice_share_at(0.0)
        self._lessons = lessons
        super().__init__(
            config,
            policy,
            env,
            loss=partial(minibatch_loss, config),
            targets={
                "actions": (tuple(lessons.actions.shape), torch.int64),
                "weights": (tuple(lessons.way.shape), torch.float32),
            },
            recorder=lessons,
            auxiliary_coef=config.auxiliary_coef,
            greedy=True,
            **options,
        )
        self._average = flatten_parameters(policy)

    def parameters(self) -> np.ndarray:
        """Copy the averaged parameters, which interim evaluations play."""
        return self._average.copy()

    @torch.no_grad()
    def collect(self, progress: float) -> None:
        """Let the policy act; at first, fill the rollout with first images of new episodes."""
        self._lessons.teaching.practice_share = self.config.practice_share_at(progress)
        if progress >= self.config.glimpse_until:
            super().collect(progress)
            return
        rollout = self._learner.rollout
        rollout.episode_start.fill_(True)
        for t in range(len(rollout.reward)):
            rollout.patches[t] = self.policy.patches(self._collector.restart())
            rollout.knowledge[t] = self._collector.env.knowledge
            self._lessons.before_step(t)

    def set_targets(self) -> None:
        """Fill the targets: the teacher's actions, weighted by way.

        Weights have a mean of 1: a joint that moves the wrong way is worse far from the solution.
        """
        lessons = self._lessons
        targets = self._learner.targets
        targets["actions"].copy_(lessons.actions)
        way = lessons.way.abs().clamp(SHORTEST_WAY, self.config.way_limit)
        targets["weights"].copy_(way / way.mean())

    def update(self, total_steps: int) -> Metrics:
        """See `MinibatchTrainer.update`; also averages the parameters."""
        metrics = super().update(total_steps)
        change = flatten_parameters(self.policy) - self._average
        self._average += change / np.float32(AVERAGE_UPDATES)
        return metrics

    def checkpoint(self) -> Checkpoint:
        """See `SynchronousTrainer.checkpoint`."""
        checkpoint = super().checkpoint()
        checkpoint.state["average"] = self._average.copy()
        return checkpoint

    def restore(self, checkpoint: Checkpoint) -> None:
        """See `Trainer.restore`."""
        super().restore(checkpoint)
        self._average = checkpoint.state["average"].copy()
