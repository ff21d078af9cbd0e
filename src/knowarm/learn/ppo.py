"""PPO: recurrent proximal policy optimization."""

from functools import partial
from typing import Any

import torch
from torch import Tensor

from knowarm.errors import UserError
from knowarm.learn.algorithms import PPOConfig
from knowarm.learn.checkpoint import Arrays, select
from knowarm.learn.environment import ThresholdCurriculum, TorchVectorEnv
from knowarm.learn.evaluation import Metrics
from knowarm.learn.guards import HealthMonitor
from knowarm.learn.losses import Terms, advantages, ppo_loss
from knowarm.learn.minibatch import MinibatchTrainer
from knowarm.learn.network import Targets, TrainingNetwork
from knowarm.learn.privileged import PrivilegedRecorder, StateCritic
from knowarm.learn.rollout import Rollout
from knowarm.policy import Policy

PROGRESS = {"distance/0": 100.0, "angle/0": 20.0 / 90.0}
"""Reward of progress per metre and per degree, by column of the privileged state."""


def minibatch_loss(
    config: PPOConfig, network: TrainingNetwork, batch: Rollout, targets: Targets
) -> Terms:
    """Compute PPO's loss, and the auxiliary one, over a minibatch."""
    logits, values, features = network(batch)
    terms = ppo_loss(
        logits,
        values,
        batch.action,
        batch.log_probability,
        targets["advantage"],
        targets["returns"],
        config,
    )
    return network.add_auxiliary(terms, features, targets, config.privileged.auxiliary_coef)


class PPOTrainer(MinibatchTrainer):
    """Recurrent PPO with minibatches of whole environments; see `MinibatchTrainer`."""

    config: PPOConfig

    def __init__(
        self, config: PPOConfig, policy: Policy, env: TorchVectorEnv, *, seed: int, **options: Any
    ) -> None:
        aids = config.privileged
        recorder = None
        if aids.critic or aids.auxiliary_coef or aids.progress_coef:
            recorder = PrivilegedRecorder(env, config.rollout_steps)
            if aids.progress_coef and not set(PROGRESS) <= set(recorder.columns):
                raise UserError(
                    f"progress_coef needs the privileged columns {', '.join(PROGRESS)}; "
                    f"{type(env).__name__} has {', '.join(recorder.columns)}. Add them, or set it "
                    "to 0."
                )
        self._critic = None
        if recorder is not None and aids.critic:
            self._critic = StateCritic(len(recorder.columns), env.device, seed)
        self._curriculum = ThresholdCurriculum(aids, env)
        table = ((config.rollout_steps, config.num_envs), torch.float32)
        super().__init__(
            config,
            policy,
            env,
            seed=seed,
            loss=partial(minibatch_loss, config),
            targets={"advantage": table, "returns": table},
            recorder=recorder,
            auxiliary_targets=recorder.auxiliary_targets
            if recorder is not None and aids.auxiliary_coef
            else 0,
            curriculum=self._curriculum,
            final_values=self._critic is None,
            **options,
        )
        self._health = HealthMonitor(policy.shape.joints, policy.shape.levels, config.gamma)

    def set_targets(self) -> None:
        """Compute advantages and returns, train the critic, and fill the auxiliary targets."""
        config, rollout, targets = self.config, self._learner.rollout, self._learner.targets
        recorder, critic, following = self._recorder, self._critic, None
        if recorder is not None and critic is not None:
            value, following = map(critic, recorder.standardized)
            rollout.value.copy_(value)
            following = torch.where(rollout.terminated, 0, following)
        advantage = advantages(
            self.rewards(),
            rollout.value,
            rollout.following() if following is None else following,
            rollout.done,
            config.gamma,
            config.gae_lambda,
        )
        targets["returns"].copy_(advantage + rollout.value)
        if recorder is not None and critic is not None:
            critic.fit(recorder.standardized[0].flatten(0, 1), targets["returns"].flatten())
        targets["advantage"].copy_((advantage - advantage.mean()) / (advantage.std() + 1e-8))
        if recorder is not None and "auxiliary" in targets:
            targets["auxiliary"].copy_(recorder.targets())

    def rewards(self) -> Tensor:
        """Return the rewards of learning, (T, B): with those for progress, and scaled."""
        reward, recorder = self._learner.rollout.reward, self._recorder
        if recorder is not None and self.config.privileged.progress_coef:
            gained = recorder.state - recorder.next_state
            parts = [
                factor * gained[..., recorder.columns.index(name)]
                for name, factor in PROGRESS.items()
            ]
            reward = reward + self.config.privileged.progress_coef * (parts[0] + parts[1])
        return reward * self.config.reward_scale

    def update(self, total_steps: int) -> Metrics:
        """See `MinibatchTrainer.update`; also moves the success thresholds."""
        metrics = super().update(total_steps)
        rollout, returns = self._learner.rollout, self._learner.targets["returns"]
        self._health.watch(
            step=self.step,
            entropy=metrics["entropy"],
            values=rollout.value,
            rewards=self.rewards(),
        )
        metrics["explained_variance"] = explained_variance(rollout.value, returns)
        if self._curriculum.is_used:
            metrics["threshold_factor"] = self._curriculum.factor
            self._curriculum.update(metrics.get("success", 0.0), self.step / total_steps)
        return metrics

    def extra_state(self) -> Arrays:
        """See `MinibatchTrainer.extra_state`."""
        critic = {} if self._critic is None else self._critic.get_state()
        return {f"critic/{k}": v for k, v in critic.items()}

    def restore_extra(self, state: Arrays) -> None:
        """See `MinibatchTrainer.restore_extra`."""
        if self._critic is not None:
            self._critic.set_state(select(state, "critic/"))


def explained_variance(values: Tensor, returns: Tensor) -> float:
    """Return the fraction of the returns' variance explained by the values; 1 is perfect."""
    variance = float(returns.var())
    return 1 - float((returns - values).var()) / variance if variance > 0 else 0.0
