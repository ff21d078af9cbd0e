"""A policy, environments and knowledge go in; a trained policy and its learning curve come out."""

import time
from pathlib import Path
from typing import cast

import numpy as np
import torch
from torch import Tensor

from knowarm.errors import UserError
from knowarm.learn.allocator import keep_freed_memory
from knowarm.learn.checkpoint import Checkpoint, CheckpointStore, policy_arrays
from knowarm.learn.collector import Collector, below
from knowarm.learn.config import PPOConfig
from knowarm.learn.environment import VectorEnvironment
from knowarm.learn.evaluation import BackgroundEvaluations, Evaluations, InlineEvaluations
from knowarm.learn.evaluator import MakeEvaluate
from knowarm.learn.guards import FiniteGuard, HealthMonitor
from knowarm.learn.learner import make_learner
from knowarm.learn.losses import PPOLossTerms
from knowarm.learn.precision import resolve_precision
from knowarm.learn.returns import advantages
from knowarm.learn.schedule import step_size
from knowarm.learn.tensor_collector import (
    TensorCollector,
    TensorEnvironment,
    has_tensors,
)
from knowarm.learn.trainer import Best, Evaluate, Hooks, Metrics, TrainingResult, crossed
from knowarm.policy import Policy


class PPOTrainer:
    """Recurrent PPO with minibatches over environments and stored start states.

    Args:
        config: all choices.
        policy: trained in place.
        env: ``config.num_envs`` environments that reset within the step; where they take and give
            tensors of a device, everything happens there.
        knowledge_table: (F, K) float32, one row a facet of the environment.
        seed: of episodes, actions and minibatches.
        evaluate: plays the interim evaluation while training waits; None for none.
        make_evaluate: instead of ``evaluate``, makes it in a process of its own, which plays while
            training goes on; picklable. Results may come later than their step.
        evaluate_every: steps between two interim evaluations; the first is before training.
        hooks: who is told of metrics and evaluations.
        checkpoints: where checkpoints go; None keeps none.
        checkpoint_every: steps between two checkpoints.
        failure_folder: where a batch with a NaN is saved; None saves nothing.

    Attributes:
        step: environment steps taken so far.
        best: the best interim evaluation so far.
        precision: what ``config.matmul_precision`` means on this machine.

    Raises:
        UserError: the config asks for a GPU and the environment is not on one, for a precision
            that the device lacks, or the table has no row for a facet.
    """

    def __init__(
        self,
        config: PPOConfig,
        policy: Policy,
        env: VectorEnvironment | TensorEnvironment,
        knowledge_table: np.ndarray,
        *,
        seed: int,
        evaluate: Evaluate | None = None,
        make_evaluate: MakeEvaluate | None = None,
        evaluate_every: int = 50_000,
        hooks: Hooks | None = None,
        checkpoints: CheckpointStore | None = None,
        checkpoint_every: int = 200_000,
        failure_folder: Path | None = None,
    ) -> None:
        assert env.num_envs == config.num_envs, (env.num_envs, config.num_envs)
        keep_freed_memory()
        self.config = config
        self.policy = policy
        self.step = 0
        self.best = Best()
        self._device = torch.device(getattr(env, "device", "cpu"))
        if config.device == "cuda" and self._device.type != "cuda":
            raise UserError(
                f"The config's device is 'cuda' and the environment is on {self._device}: give a "
                "TorchReachVectorEnv(..., device='cuda'), or device='cpu' in the config."
            )
        self.matmul_precision = resolve_precision(config.matmul_precision, self._device)
        self._learner = make_learner(
            policy, config, knowledge_table, self.matmul_precision, self._device
        )
        self._hooks = hooks or Hooks()
        self._evaluate = evaluate
        self._make_evaluate = make_evaluate
        self._evaluations: Evaluations | None = None
        self._evaluate_every = evaluate_every
        self._checkpoints = checkpoints
        self._checkpoint_every = checkpoint_every
        self._table = torch.tensor(knowledge_table, dtype=torch.float32, device=self._device)
        self._collector = make_collector(env, policy, self._table, seed=seed)
        self._order = torch.Generator(self._device).manual_seed(seed)
        self._optimizer = torch.optim.Adam(
            policy.parameters(), lr=config.learning_rate, eps=config.adam_epsilon, fused=True
        )
        self._guard = FiniteGuard(failure_folder)
        self._health = HealthMonitor(policy.config.joints, policy.config.levels, config.gamma)

    def train(self, total_steps: int) -> TrainingResult:
        """Train until ``total_steps`` environment steps were taken in all.

        The learning rate falls over ``total_steps``, so a resumed training must be given the
        same number to end with the same bytes.

        Raises:
            NotFiniteError: a loss, gradient or input is NaN or infinite.
            UserError: a checkpoint cannot be written, or a GPU's memory is full.
        """
        if self._evaluate is not None:
            self._evaluations = InlineEvaluations(self._evaluate)
        elif self._make_evaluate is not None:
            self._evaluations = BackgroundEvaluations(self.policy, self._make_evaluate)
        try:
            with self._learner.at_work():
                return self._train(total_steps)
        except torch.OutOfMemoryError as error:
            raise UserError(
                f"The GPU's memory was full at step {self.step} with {self.config.num_envs} "
                f"environments and {self.config.minibatches} minibatches of them: choose a smaller "
                "num_envs or rollout_steps, more minibatches, or stop what else runs on the GPU. "
                f"The last checkpoint is whole. ({error})"
            ) from error
        finally:
            if self._evaluations is not None:
                self._evaluations.end()

    def _train(self, total_steps: int) -> TrainingResult:
        begin, reason = time.perf_counter(), "finished"
        if self.step == 0:
            self._ask_for_evaluation()
        while self.step < total_steps:
            if self._hooks.should_stop():
                reason = "stopped"
                break
            before, start = self.step, time.perf_counter()
            self.policy.matmul_precision = self.matmul_precision
            metrics = self._update(total_steps)
            self.policy.matmul_precision = "float32"
            now = time.perf_counter()
            self._hooks.on_metrics(
                {
                    "step": self.step,
                    "wall_time_s": now - begin,
                    "steps_per_s": (self.step - before) / (now - start),
                    **metrics,
                }
            )
            if crossed(before, self.step, self._evaluate_every):
                self._ask_for_evaluation()
            self._take_evaluations(wait=False)
            if crossed(before, self.step, self._checkpoint_every):
                self.save()
        self.save()
        return TrainingResult(
            step=self.step,
            reason="stopped" if reason == "stopped" else "finished",
            best_return=self.best.value,
            best_step=self.best.step,
        )

    def save(self) -> None:
        """Write a checkpoint now, if there is a place for it; waits for interim evaluations."""
        self._take_evaluations(wait=True)
        if self._checkpoints is not None:
            self._checkpoints.save(self._checkpoint())

    def resume(self) -> None:
        """Go on from the latest whole checkpoint.

        Raises:
            UserError: there is none, or it belongs to something else.
        """
        assert self._checkpoints is not None, "resuming needs a checkpoint store"
        checkpoint = self._checkpoints.load()
        self.policy.load_state_dict({k: torch.from_numpy(v) for k, v in checkpoint.policy.items()})
        for name, parameter in self.policy.named_parameters():
            self._optimizer.state[parameter] = {
                key: torch.from_numpy(value).to(self._device)
                for key, value in below(checkpoint.optimizer, f"{name}/").items()
            }
        self._collector.set_state(below(checkpoint.state, "collector/"))
        self._order.set_state(torch.from_numpy(checkpoint.state["order"]))
        self.step = checkpoint.facts["step"]
        self.best = Best(checkpoint.facts["best_return"], checkpoint.facts["best_step"])

    def _checkpoint(self) -> Checkpoint:
        return Checkpoint(
            policy=policy_arrays(self.policy),
            optimizer={
                f"{name}/{key}": value.cpu().numpy().copy()
                for name, parameter in self.policy.named_parameters()
                for key, value in self._optimizer.state[parameter].items()
            },
            state={
                "order": self._order.get_state().numpy(),
                **{f"collector/{k}": v for k, v in self._collector.get_state().items()},
            },
            facts={
                "step": self.step,
                "best_return": self.best.value,
                "best_step": self.best.step,
            },
        )

    def _ask_for_evaluation(self) -> None:
        if self._evaluations is not None:
            self._evaluations.ask(self.step, self.policy)
            self._take_evaluations(wait=False)

    def _take_evaluations(self, *, wait: bool) -> None:
        """Keep the best of the policies whose evaluation has come, and tell of all."""
        if self._evaluations is None:
            return
        for done in self._evaluations.finished(wait=wait):
            is_best = self.best.update(done.step, done.results["return_mean"])
            if is_best and self._checkpoints is not None:
                facts = {"step": done.step, **done.results}
                self._checkpoints.save_best(Checkpoint(policy=done.policy, facts=facts))
            self._hooks.on_evaluation(done.step, done.results, is_best)

    def _update(self, total_steps: int) -> Metrics:
        """Collect one rollout, learn from it, and describe both."""
        config, rollout = self.config, self._learner.rollout
        rate = step_size(
            config.learning_rate_schedule,
            config.learning_rate,
            config.learning_rate_final,
            self.step / total_steps,
        )
        for group in self._optimizer.param_groups:
            group["lr"] = rate
        environment_s, start = self._collector.environment_s, time.perf_counter()
        self._collector.collect(self._learner, rollout)
        # This waits for a GPU, whose work is not done when its kernels are launched.
        environment_s = self._collector.environment_s - environment_s
        collected = time.perf_counter()
        self.step += rollout.reward.numel()
        self._guard.check_rollout(rollout, self._table, self.step)
        reward = rollout.reward * config.reward_scale
        self._set_targets(reward)
        terms, norms = self._learn()
        self._guard.check_updates(terms, norms, self.step, rollout)
        learnt = time.perf_counter()
        means = {
            f"{name}": float(torch.stack([getattr(term, name) for term in terms]).mean())
            for name in ("policy", "value", "entropy", "kl", "clipped")
        }
        self._health.watch(
            step=self.step, entropy=means["entropy"], values=rollout.value, rewards=reward
        )
        return {
            **self._collector.statistics.take().summary(),
            "policy_loss": means["policy"],
            "value_loss": means["value"],
            "entropy": means["entropy"],
            "kl": means["kl"],
            "clipped": means["clipped"],
            "explained_variance": explained_variance(rollout.value, self._learner.targets.returns),
            "grad_norm": float(torch.stack(norms).mean()),
            "learning_rate": rate,
            "gradient_steps": len(terms),
            "environment_s": environment_s,
            "inference_s": collected - start - environment_s,
            "learn_s": learnt - collected,
        }

    def _set_targets(self, reward: Tensor) -> None:
        """Write the advantages and returns of (scaled) rewards (T, B)."""
        config, rollout, targets = self.config, self._learner.rollout, self._learner.targets
        advantage = advantages(
            reward,
            rollout.value,
            rollout.following(),
            rollout.done,
            config.gamma,
            config.gae_lambda,
        )
        targets.returns.copy_(advantage + rollout.value)
        if config.normalize_advantages:
            advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        targets.advantage.copy_(advantage)

    def _learn(self) -> tuple[list[PPOLossTerms], list[Tensor]]:
        """Pass over the rollout ``epochs`` times; return the loss terms of every minibatch."""
        config = self.config
        terms: list[PPOLossTerms] = []
        norms: list[Tensor] = []
        for _ in range(config.epochs):
            order = torch.randperm(config.num_envs, generator=self._order, device=self._device)
            for columns in order.chunk(config.minibatches):
                loss = self._learner.differentiate(columns)
                terms.append(loss)
                if config.target_kl is not None and float(loss.kl) > config.target_kl:
                    return terms, norms or [torch.zeros(())]
                norms.append(self._descend(loss))
        return terms, norms

    def _descend(self, loss: PPOLossTerms) -> Tensor:
        """Take one gradient step; return the norm of the gradient before it was shortened.

        A gradient that is not finite never reaches the parameters: on the CPU it stops training
        here; a GPU is not waited for, so there it counts as zero until the pass is over.
        """
        gradient, limit = self._learner.gradient, self.config.max_grad_norm
        norm = torch.linalg.vector_norm(gradient)
        if self._device.type == "cpu":
            self._guard.check_update(self.policy, loss, norm, self.step, self._learner.rollout)
            if norm > limit:
                gradient.mul_(limit / norm)
        else:
            finite, shorter = torch.isfinite(norm + loss.total), (limit / norm).clamp(max=1)
            gradient.copy_(torch.where(finite, gradient * shorter, 0))
        self._optimizer.step()
        return norm


def make_collector(
    env: VectorEnvironment | TensorEnvironment, policy: Policy, table: Tensor, *, seed: int
) -> Collector | TensorCollector:
    """Return what steps an environment: by tensors where it has a device, else by arrays."""
    if has_tensors(env):
        return TensorCollector(env, policy, table, seed=seed)
    return Collector(cast(VectorEnvironment, env), policy, table, seed=seed)


def explained_variance(values: Tensor, returns: Tensor) -> float:
    """Share of the returns' variance that the values explain: 1 is perfect, 0 a constant."""
    variance = float(returns.var())
    return 1 - float((returns - values).var()) / variance if variance > 0 else 0.0
