"""PPO, and the base of trainers that learn from minibatches of whole environments as it does."""

import time
from abc import abstractmethod
from functools import partial
from typing import Any

import torch
from torch import Tensor

from knowarm.errors import UserError
from knowarm.learn.algorithms import MinibatchConfig, PPOConfig
from knowarm.learn.checkpoint import (
    Checkpoint,
    HasState,
    policy_arrays,
    prefixed,
    select,
    to_arrays,
    to_tensors,
)
from knowarm.learn.environment import ThresholdCurriculum, TorchVectorEnv
from knowarm.learn.evaluation import Metrics
from knowarm.learn.guards import FiniteGuard, HealthMonitor
from knowarm.learn.learner import Learner, Loss, Targets, TrainingNetwork
from knowarm.learn.losses import Terms, advantages, ppo_loss
from knowarm.learn.optimizer import PolicyOptimizer, resolve_precision
from knowarm.learn.parallel.processes import keep_freed_memory
from knowarm.learn.parallel.shared_tensors import TensorSpecs, clip_gradient
from knowarm.learn.privileged import PrivilegedRecorder, StateCritic
from knowarm.learn.rollout import Collector, Rollout
from knowarm.learn.trainer import StopReason, SynchronousTrainer
from knowarm.policy import Policy
from knowarm.seeding import torch_generator

PROGRESS = {"distance/0": 100.0, "angle/0": 20.0 / 90.0}
"""Reward of progress per metre and per degree, by column of the privileged state."""


class MinibatchTrainer(SynchronousTrainer):
    """Collects a rollout, sets targets, and takes gradient steps on minibatches of environments.

    Recurrent states at the start of the rollout are stored with it. `train` changes two settings
    of the process: PyTorch's thread count, restored afterwards, and the memory allocator
    (`keep_freed_memory`). On a GPU convolutions no longer round to TF32.

    Args:
        config: the algorithm's configuration.
        policy: trained in place, on the environment's device.
        env: ``config.num_envs`` environments; see `knowarm.learn.NumpyToTorch` for those of
            Gymnasium.
        loss: of a minibatch; picklable.
        targets: shapes and dtypes of what the loss needs besides rollout and auxiliary targets.
        recorder: records the simulator's state, if the algorithm uses it.
        auxiliary_coef: coefficient of the auxiliary loss; 0: no auxiliary head.
        greedy: collect with the most probable actions.
        final_values: as `Collector`.
        options: as `Trainer`; with streams of ``seed`` for episodes, actions and minibatches.

    Attributes:
        matmul_precision: what ``config.matmul_precision`` means on this machine.

    Raises:
        UserError: the number of environments or the device differs from the config's, the device
            lacks the precision, or the environment's knowledge does not fit the policy.
    """

    def __init__(
        self,
        config: MinibatchConfig,
        policy: Policy,
        env: TorchVectorEnv,
        *,
        loss: Loss,
        targets: TensorSpecs,
        recorder: PrivilegedRecorder | None,
        auxiliary_coef: float,
        greedy: bool = False,
        final_values: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(policy, **options)
        if env.num_envs != config.num_envs:
            raise UserError(
                f"The config's num_envs is {config.num_envs} and the environment has "
                f"{env.num_envs}; make them equal."
            )
        device = env.device
        if config.device == "cuda" and device.type != "cuda":
            raise UserError(
                f"The config's device is 'cuda' and the environment is on {device}: create "
                "the environment with device='cuda', or pass device='cpu' in the config."
            )
        self.config = config
        self._recorder = recorder
        precision = resolve_precision(config.matmul_precision, device)
        self.matmul_precision = precision
        auxiliary_targets = 0
        if recorder is not None and auxiliary_coef:
            auxiliary_targets = recorder.auxiliary_targets
        seed = self.seed
        network = TrainingNetwork(policy.to(device), auxiliary_targets, seed)
        self._head = network.head
        self._learner = Learner(network, config, loss, targets, precision, device)
        self._collector = Collector(
            env, policy, seed=seed, final_values=final_values, greedy=greedy
        )
        self._minibatch_generator = torch_generator(seed, "minibatches", device=device)
        parameters = network.parameters_by_name()
        self._optimizer = PolicyOptimizer(parameters, config, self._learner.processes)
        self._guard = FiniteGuard(self.failure_folder)
        # What has a state in checkpoints, with the prefix of its arrays there.
        self._parts: list[tuple[str, HasState]] = [("collector/", self._collector)]
        if recorder is not None:
            self._parts.append(("privileged/", recorder.normalizer))

    @abstractmethod
    def set_targets(self) -> None:
        """Compute the targets of the loss from the rollout, but those of the auxiliary head."""

    def collect(self, progress: float) -> None:
        """Fill the rollout, after a fraction ``progress`` of the training."""
        self._collector.collect(
            self._learner.rollout, self._learner.infer, recorder=self._recorder
        )

    def _train(self, total_steps: int) -> StopReason:
        keep_freed_memory()
        with self.policy.computing(self.matmul_precision), self._learner.running():
            return super()._train(total_steps)

    def checkpoint(self) -> Checkpoint:
        """See `SynchronousTrainer.checkpoint`."""
        state = to_arrays({"order": self._minibatch_generator.get_state()})
        for prefix, part in self._parts:
            state |= prefixed(prefix, part.get_state())
        if self._head is not None:
            state |= prefixed("auxiliary/", policy_arrays(self._head))
        return Checkpoint(
            policy=policy_arrays(self.policy),
            optimizer=self._optimizer.get_state(),
            state=state,
        )

    def restore(self, checkpoint: Checkpoint) -> None:
        """See `Trainer.restore`."""
        state = checkpoint.state
        self._optimizer.set_state(checkpoint.optimizer)
        if self._head is not None:
            self._head.load_state_dict(to_tensors(select(state, "auxiliary/")))
        for prefix, part in self._parts:
            part.set_state(select(state, prefix))
        self._minibatch_generator.set_state(torch.tensor(state["order"]))

    def update(self, total_steps: int) -> Metrics:
        """Collect one rollout, learn from it, and return the metrics of both."""
        rollout = self._learner.rollout
        collector = self._collector
        progress = self.step / total_steps
        rate = self.config.learning_rate_at(progress)
        self._optimizer.set_learning_rate(rate)
        collector.environment_s = 0.0
        begin = time.perf_counter()
        self.collect(progress)
        collected = time.perf_counter()
        self.step += rollout.reward.numel()
        # Stop before a number that is not finite reaches the parameters.
        self._guard.check_rollout(rollout, self.step)
        if self._recorder is not None:
            self._recorder.standardize()
            if self._head is not None:
                self._learner.targets["auxiliary"].copy_(self._recorder.targets())
        self.set_targets()
        means = self._learn()
        learned = time.perf_counter()
        return {
            **collector.statistics.take().summary(),
            **means,
            "learning_rate": rate,
            "environment_s": collector.environment_s,
            "inference_s": collected - begin - collector.environment_s,
            "learn_s": learned - collected,
        }

    def _learn(self) -> Metrics:
        """Run all epochs; return the means over minibatches of loss terms and gradient norms."""
        config = self.config
        learner = self._learner
        measured: list[Terms] = []
        for _ in range(config.epochs):
            # Environments stay whole, since a recurrent state passes through all of their steps.
            generator = self._minibatch_generator
            order = torch.randperm(
                config.num_envs, generator=generator, device=generator.device
            )
            for env_ids in order.chunk(config.minibatches):
                loss = learner.compute_gradient(env_ids)
                norm = clip_gradient(learner.gradient, config.max_grad_norm)
                self._guard.check_update(
                    self.policy, loss, norm, self.step, learner.rollout
                )
                self._optimizer.step()
                del loss["total"]
                measured.append({**loss, "grad_norm": norm})
        means = {}
        for name in measured[0]:
            values = torch.stack([terms[name] for terms in measured])
            means[name] = float(values.mean())
        return means


def minibatch_loss(
    config: PPOConfig,
    network: TrainingNetwork,
    batch: Rollout,
    targets: Targets,
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
    return network.add_auxiliary(
        terms, features, targets, config.privileged.auxiliary_coef
    )


class PPOTrainer(MinibatchTrainer):
    """Recurrent PPO with minibatches of whole environments; see `MinibatchTrainer`."""

    config: PPOConfig

    def __init__(
        self,
        config: PPOConfig,
        policy: Policy,
        env: TorchVectorEnv,
        **options: Any,
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
        self._curriculum = ThresholdCurriculum(aids, env)
        table = ((config.rollout_steps, config.num_envs), torch.float32)
        super().__init__(
            config,
            policy,
            env,
            loss=partial(minibatch_loss, config),
            targets={"advantage": table, "returns": table},
            recorder=recorder,
            auxiliary_coef=aids.auxiliary_coef,
            final_values=not aids.critic,
            **options,
        )
        self._parts.append(("collector/", self._curriculum))
        self._critic = None
        if recorder is not None and aids.critic:
            self._critic = StateCritic(len(recorder.columns), env.device, self.seed)
            self._parts.append(("critic/", self._critic))
        self._health = HealthMonitor(
            policy.shape.joints, policy.shape.levels, config.gamma
        )

    def set_targets(self) -> None:
        """Compute advantages and returns, and train the critic."""
        rollout = self._learner.rollout
        targets = self._learner.targets
        recorder = self._recorder
        critic = self._critic
        if recorder is not None and critic is not None:
            state, next_state = recorder.standardized
            rollout.value.copy_(critic(state))
            # The critic sees the state after every step, also after the last one of an episode.
            following = torch.where(rollout.terminated, 0, critic(next_state))
        else:
            following = rollout.following()
        advantage = advantages(
            self.rewards(),
            rollout.value,
            following,
            rollout.done,
            self.config.gamma,
            self.config.gae_lambda,
        )
        targets["returns"].copy_(advantage + rollout.value)
        # The critic learns last: the advantages need the values from before.
        if recorder is not None and critic is not None:
            critic.fit(
                recorder.standardized[0].flatten(0, 1), targets["returns"].flatten()
            )
        targets["advantage"].copy_(
            (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        )

    def rewards(self) -> Tensor:
        """Return the rewards of learning, (T, B): with those for progress, and scaled."""
        reward = self._learner.rollout.reward
        recorder = self._recorder
        coefficient = self.config.privileged.progress_coef
        if recorder is not None and coefficient:
            decrease = recorder.state - recorder.next_state
            progress = torch.zeros_like(reward)
            for name, factor in PROGRESS.items():
                column = recorder.columns.index(name)
                progress = progress + factor * decrease[..., column]
            reward = reward + coefficient * progress
        return reward * self.config.reward_scale

    def update(self, total_steps: int) -> Metrics:
        """See `MinibatchTrainer.update`; also moves the success thresholds."""
        metrics = super().update(total_steps)
        values = self._learner.rollout.value
        self._health.watch(
            step=self.step,
            entropy=metrics["entropy"],
            values=values,
            rewards=self.rewards(),
        )
        returns = self._learner.targets["returns"]
        metrics["explained_variance"] = explained_variance(values, returns)
        if self._curriculum.is_used:
            metrics["threshold_factor"] = self._curriculum.factor
            self._curriculum.update(
                metrics.get("success", 0.0), self.step / total_steps
            )
        return metrics


def explained_variance(values: Tensor, returns: Tensor) -> float:
    """Return the fraction of the returns' variance explained by the values; 1 is perfect."""
    variance = float(returns.var())
    if variance > 0:
        return 1 - float((returns - values).var()) / variance
    return 0.0
