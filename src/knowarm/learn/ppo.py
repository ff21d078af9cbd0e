"""PPO trainer: recurrent proximal policy optimization."""

import time
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor

from knowarm.errors import UserError
from knowarm.learn.algorithms import PPOConfig, privileged_uses
from knowarm.learn.checkpoint import Checkpoint, policy_arrays, select
from knowarm.learn.collector import Collector
from knowarm.learn.environment import PrivilegedVectorEnv, ThresholdCurriculum, TorchVectorEnv
from knowarm.learn.evaluation import Metrics
from knowarm.learn.guards import FiniteGuard, HealthMonitor
from knowarm.learn.learner import make_learner
from knowarm.learn.losses import PPOLossTerms, advantages
from knowarm.learn.optimizer import PolicyOptimizer, resolve_precision
from knowarm.learn.parallel.processes import keep_freed_memory
from knowarm.learn.parallel.shared_tensors import flatten_parameters
from knowarm.learn.privileged import PrivilegedLearning, teaching_env
from knowarm.learn.rollout import TrainingNetwork
from knowarm.learn.trainer import StopReason, SynchronousTrainer
from knowarm.policy import Policy
from knowarm.seeding import torch_generator

LOSS_METRICS = {
    "policy_loss": "policy",
    "value_loss": "value",
    "entropy": "entropy",
    "approx_kl": "approx_kl",
    "clip_fraction": "clip_fraction",
}
"""Metrics that are means over gradient steps, and their fields of the loss terms."""


class PPOTrainer(SynchronousTrainer):
    """Recurrent PPO with minibatches of whole environments and stored initial states.

    `train` changes two settings of the process: PyTorch's thread count, restored afterwards, and
    the memory allocator (`keep_freed_memory`). On a GPU convolutions no longer round to TF32.

    Args:
        config: the algorithm's configuration.
        policy: trained in place, on the environment's device.
        env: ``config.num_envs`` environments; see `knowarm.learn.NumpyToTorch` for those of
            Gymnasium.
        seed: of the run; episodes, actions and minibatches have a stream each.
        options: as `Trainer`.

    Attributes:
        matmul_precision: what ``config.matmul_precision`` means on this machine.

    Raises:
        UserError: the number of environments or the device differs from the config's, the device
            lacks the precision, or the knowledge table has no row for a facet.
    """

    def __init__(
        self, config: PPOConfig, policy: Policy, env: TorchVectorEnv, *, seed: int, **options: Any
    ) -> None:
        super().__init__(policy, seed=seed, **options)
        if env.num_envs != config.num_envs:
            raise UserError(
                f"The config's num_envs is {config.num_envs} and the environment has "
                f"{env.num_envs}; make them equal."
            )
        self.config = config
        self._device = env.device
        if config.device == "cuda" and self._device.type != "cuda":
            raise UserError(
                f"The config's device is 'cuda' and the environment is on {self._device}: create "
                "the environment with device='cuda', or pass device='cpu' in the config."
            )
        self.matmul_precision = resolve_precision(config.matmul_precision, self._device)
        self._privileged = None
        targets = 0
        if privileged_uses(vars(config)):
            self._privileged = PrivilegedLearning(config, cast(PrivilegedVectorEnv, env), seed)
            if config.auxiliary_coef:
                targets = self._privileged.auxiliary_targets().shape[-1]
        self._curriculum = ThresholdCurriculum(config, env)
        if config.practice_until:
            teaching_env(env).practice_share = config.practice_share_at(0.0)
        network = TrainingNetwork(policy.to(self._device), targets, seed)
        self._head = network.head
        self._learner = make_learner(network, config, self.matmul_precision, self._device)
        self._collector = Collector(
            env,
            policy,
            seed=seed,
            final_values=config.critic == "image" and config.reinforcement_coef > 0,
            greedy=config.reinforcement_coef == 0,
            curriculum=self._curriculum,
        )
        self._minibatch_generator = torch_generator(seed, "minibatches", device=self._device)
        parameters = network.parameters_by_name()
        self._optimizer = PolicyOptimizer(parameters, config, self._learner.processes)
        self._average = None
        if config.average_updates is not None:
            self._average = flatten_parameters(policy)
        self._guard = FiniteGuard(self.failure_folder)
        self._health = HealthMonitor(policy.shape.joints, policy.shape.levels, config.gamma)

    def parameters(self) -> np.ndarray:
        """Copy the parameters that interim evaluations play: the averages, if there are any."""
        return super().parameters() if self._average is None else self._average.copy()

    def _train(self, total_steps: int) -> StopReason:
        keep_freed_memory()
        self.policy.matmul_precision = self.matmul_precision
        try:
            with self._learner.running():
                return super()._train(total_steps)
        finally:
            self.policy.matmul_precision = "float32"

    def checkpoint(self) -> Checkpoint:
        """See `SynchronousTrainer.checkpoint`."""
        privileged = self._privileged.get_state() if self._privileged else {}
        head = {} if self._head is None else policy_arrays(self._head)
        average = {} if self._average is None else {"average": self._average.copy()}
        return Checkpoint(
            policy=policy_arrays(self.policy),
            optimizer=self._optimizer.get_state(),
            state={
                "order": self._minibatch_generator.get_state().numpy(),
                **{f"collector/{k}": v for k, v in self._collector.get_state().items()},
                **{f"privileged/{k}": v for k, v in privileged.items()},
                **{f"auxiliary/{k}": v for k, v in head.items()},
                **average,
            },
        )

    def restore(self, checkpoint: Checkpoint) -> None:
        """See `Trainer.restore`."""
        self._optimizer.set_state(checkpoint.optimizer)
        if self._head is not None:
            arrays = select(checkpoint.state, "auxiliary/")
            self._head.load_state_dict({k: torch.from_numpy(v) for k, v in arrays.items()})
        if self._average is not None:
            self._average = checkpoint.state["average"].copy()
        if self._privileged is not None:
            self._privileged.set_state(select(checkpoint.state, "privileged/"))
        self._collector.set_state(select(checkpoint.state, "collector/"))
        self._minibatch_generator.set_state(torch.from_numpy(checkpoint.state["order"]))

    def update(self, total_steps: int) -> Metrics:
        """Collect one rollout, learn from it, and return the metrics of both."""
        config, rollout = self.config, self._learner.rollout
        progress = self.step / total_steps
        rate = config.learning_rate_at(progress)
        if config.practice_until:
            share = config.practice_share_at(progress)
            teaching_env(self._collector.env).practice_share = share
        self._optimizer.set_learning_rate(rate)
        environment_s, start = self._collector.environment_s, time.perf_counter()
        record = self._privileged.rollout if self._privileged else None
        glimpses = record is not None and progress < config.glimpse_until
        if record is not None and glimpses:
            self._collector.glimpse(rollout, record)
        else:
            self._collector.collect(rollout, self._learner.infer, privileged=record)
        environment_s = self._collector.environment_s - environment_s
        collected = time.perf_counter()
        self.step += rollout.reward.numel()
        self._guard.check_rollout(rollout, self.policy.knowledge_table, self.step)
        reward = self._set_targets()
        terms, norms = self._learn()
        if self._average is not None and config.average_updates is not None:
            change = flatten_parameters(self.policy) - self._average
            self._average += change / np.float32(config.average_updates)
        learned = time.perf_counter()
        means = {
            name: float(torch.stack([getattr(term, field) for term in terms]).mean())
            for name, field in LOSS_METRICS.items()
            if not (glimpses and name in ("approx_kl", "clip_fraction"))  # they have no actions
        }
        self._health.watch(
            step=self.step, entropy=means["entropy"], values=rollout.value, rewards=reward
        )
        episodes = self._collector.statistics.take().summary()
        options = {}
        if self._head is not None:
            options["auxiliary_loss"] = float(torch.stack([t.auxiliary for t in terms]).mean())
        if config.imitation_coef:
            options["imitation_loss"] = float(torch.stack([t.imitation for t in terms]).mean())
        if self._curriculum.is_used:
            options["threshold_factor"] = self._curriculum.factor
            self._curriculum.update(episodes.get("success", 0.0))
        return {
            **episodes,
            **options,
            **means,
            "explained_variance": explained_variance(rollout.value, self._learner.targets.returns),
            "grad_norm": float(torch.stack(norms).mean()) if norms else 0.0,
            "learning_rate": rate,
            "gradient_steps": len(norms),
            "environment_s": environment_s,
            "inference_s": collected - start - environment_s,
            "learn_s": learned - collected,
        }

    def _set_targets(self) -> Tensor:
        """Compute the targets of the losses, train the critic, and return the rewards (T, B).

        The rewards are those of learning: scaled, and with the reward for progress.
        """
        config, rollout, targets = self.config, self._learner.rollout, self._learner.targets
        privileged, reward, following = self._privileged, rollout.reward, None
        if privileged is not None:
            privileged.update()
            if config.progress_coef:
                reward = reward + privileged.progress_reward()
            if privileged.critic is not None:
                value, following = privileged.values()
                rollout.value.copy_(value)
                following = torch.where(rollout.terminated, 0, following)
            if targets.auxiliary is not None:
                targets.auxiliary.copy_(privileged.auxiliary_targets())
            if targets.teacher_actions is not None and targets.teacher_weight is not None:
                actions = privileged.rollout.teacher_actions
                assert actions is not None
                targets.teacher_actions.copy_(actions)
                targets.teacher_weight.copy_(privileged.teacher_weight())
        reward = reward * config.reward_scale
        advantage = advantages(
            reward,
            rollout.value,
            rollout.following() if following is None else following,
            rollout.done,
            config.gamma,
            config.gae_lambda,
        )
        targets.returns.copy_(advantage + rollout.value)
        if privileged is not None:
            privileged.fit(targets.returns)
        if config.normalize_advantages:
            advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        targets.advantage.copy_(advantage)
        return reward

    def _learn(self) -> tuple[list[PPOLossTerms], list[Tensor]]:
        """Run all epochs; return the loss terms and unclipped gradient norms of all minibatches."""
        config, generator = self.config, self._minibatch_generator
        terms: list[PPOLossTerms] = []
        norms: list[Tensor] = []
        for _ in range(config.epochs):
            order = torch.randperm(config.num_envs, generator=generator, device=self._device)
            for env_ids in order.chunk(config.minibatches):
                loss = self._learner.compute_gradient(env_ids)
                gradient = self._learner.gradient
                norm = torch.linalg.vector_norm(gradient)
                self._guard.check_update(self.policy, loss, norm, self.step, self._learner.rollout)
                terms.append(loss)
                if config.target_kl is not None and float(loss.approx_kl) > config.target_kl:
                    return terms, norms
                if norm > config.max_grad_norm:
                    gradient.mul_(config.max_grad_norm / norm)
                self._optimizer.step()
                norms.append(norm)
        return terms, norms


def explained_variance(values: Tensor, returns: Tensor) -> float:
    """Return the fraction of the returns' variance explained by the values; 1 is perfect."""
    variance = float(returns.var())
    return 1 - float((returns - values).var()) / variance if variance > 0 else 0.0
