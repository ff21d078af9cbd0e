"""A policy, environments and knowledge go in; a trained policy and its learning curve come out."""

import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from knowarm.learn.allocator import keep_freed_memory
from knowarm.learn.checkpoint import Checkpoint, CheckpointStore, policy_arrays
from knowarm.learn.collector import Collector, below
from knowarm.learn.config import PPOConfig
from knowarm.learn.environment import VectorEnvironment
from knowarm.learn.guards import FiniteGuard, HealthMonitor
from knowarm.learn.losses import PPOLossTerms
from knowarm.learn.precision import resolve_precision
from knowarm.learn.returns import advantages
from knowarm.learn.schedule import step_size
from knowarm.learn.team import Team
from knowarm.learn.trainer import Best, Evaluate, Hooks, Metrics, TrainingResult, crossed
from knowarm.policy import Policy


class PPOTrainer:
    """Recurrent PPO with minibatches over environments and stored start states.

    Args:
        config: all choices.
        policy: trained in place.
        env: ``config.num_envs`` environments that reset within the step.
        knowledge_table: (F, K) float32, one row a facet of the environment.
        seed: of episodes, actions and minibatches.
        evaluate: plays the interim evaluation; None for none.
        evaluate_every: steps between two interim evaluations; the first is before training.
        hooks: who is told of metrics and evaluations.
        checkpoints: where checkpoints go; None keeps none.
        checkpoint_every: steps between two checkpoints.
        failure_folder: where a batch with a NaN is saved; None saves nothing.

    Attributes:
        step: environment steps taken so far.
        best: the best interim evaluation so far.
        precision: what ``config.precision`` means on this machine.
    """

    def __init__(
        self,
        config: PPOConfig,
        policy: Policy,
        env: VectorEnvironment,
        knowledge_table: np.ndarray,
        *,
        seed: int,
        evaluate: Evaluate | None = None,
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
        self.precision = resolve_precision(config.precision)
        self._team = Team(policy, config, knowledge_table, self.precision)
        self._hooks = hooks or Hooks()
        self._evaluate = evaluate
        self._evaluate_every = evaluate_every
        self._checkpoints = checkpoints
        self._checkpoint_every = checkpoint_every
        self._table = torch.tensor(knowledge_table, dtype=torch.float32)
        self._collector = Collector(env, policy, self._table, seed=seed)
        self._order = torch.Generator().manual_seed(seed)
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
            UserError: a checkpoint cannot be written.
        """
        with self._team.at_work():
            return self._train(total_steps)

    def _train(self, total_steps: int) -> TrainingResult:
        begin, reason = time.perf_counter(), "finished"
        if self.step == 0:
            self._run_evaluation()
        while self.step < total_steps:
            if self._hooks.should_stop():
                reason = "stopped"
                break
            before, start = self.step, time.perf_counter()
            self.policy.precision = self.precision
            metrics = self._update(total_steps)
            self.policy.precision = "float32"
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
                self._run_evaluation()
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
        """Write a checkpoint now, if there is a place for it."""
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
                key: torch.from_numpy(value)
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
                f"{name}/{key}": value.numpy().copy()
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

    def _run_evaluation(self) -> None:
        if self._evaluate is None:
            return
        results = self._evaluate(self.policy)
        is_best = self.best.update(self.step, results["return_mean"])
        if is_best and self._checkpoints is not None:
            facts = {"step": self.step, **results}
            self._checkpoints.save_best(Checkpoint(policy=policy_arrays(self.policy), facts=facts))
        self._hooks.on_evaluation(self.step, results, is_best)

    def _update(self, total_steps: int) -> Metrics:
        """Collect one rollout, learn from it, and describe both."""
        config, rollout = self.config, self._team.rollout
        rate = step_size(
            config.learning_rate_schedule,
            config.learning_rate,
            config.learning_rate_final,
            self.step / total_steps,
        )
        for group in self._optimizer.param_groups:
            group["lr"] = rate
        start, environment_s = time.perf_counter(), self._collector.environment_s
        self._collector.collect(self._team, rollout)
        collected = time.perf_counter()
        environment_s = self._collector.environment_s - environment_s
        self.step += rollout.reward.numel()
        self._guard.check_rollout(rollout, self._table, self.step)
        reward = rollout.reward * config.reward_scale
        self._set_targets(reward)
        terms, norms = self._learn()
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
            "explained_variance": explained_variance(rollout.value, self._team.targets.returns),
            "gradient_norm": float(torch.stack(norms).mean()),
            "learning_rate": rate,
            "gradient_steps": len(terms),
            "environment_s": environment_s,
            "inference_s": collected - start - environment_s,
            "learn_s": learnt - collected,
        }

    def _set_targets(self, reward: Tensor) -> None:
        """Write the advantages and returns of (scaled) rewards (T, B)."""
        config, rollout, targets = self.config, self._team.rollout, self._team.targets
        advantage = advantages(
            reward,
            rollout.value,
            rollout.following(),
            rollout.done,
            config.gamma,
            config.trace_decay,
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
            order = torch.randperm(config.num_envs, generator=self._order)
            for columns in order.chunk(config.minibatches):
                loss = self._team.differentiate(columns)
                terms.append(loss)
                if config.target_kl is not None and float(loss.kl) > config.target_kl:
                    return terms, norms or [torch.zeros(())]
                norms.append(self._descend(loss))
        return terms, norms

    def _descend(self, loss: PPOLossTerms) -> Tensor:
        """Take one gradient step; return the norm of the gradient before it was shortened."""
        gradient, limit = self._team.gradient, self.config.max_gradient_norm
        norm = torch.linalg.vector_norm(gradient)
        self._guard.check_update(self.policy, loss, norm, self.step, self._team.rollout)
        if norm > limit:
            gradient.mul_(limit / norm)
        self._optimizer.step()
        return norm


def explained_variance(values: Tensor, returns: Tensor) -> float:
    """Share of the returns' variance that the values explain: 1 is perfect, 0 a constant."""
    variance = float(returns.var())
    return 1 - float((returns - values).var()) / variance if variance > 0 else 0.0
