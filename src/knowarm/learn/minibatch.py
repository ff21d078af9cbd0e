"""Base of the trainers that learn from minibatches of whole environments: PPO and imitation."""

import time
from abc import abstractmethod
from typing import Any

import torch
from torch import Tensor

from knowarm.errors import UserError
from knowarm.learn.algorithms import MinibatchConfig
from knowarm.learn.checkpoint import Arrays, Checkpoint, policy_arrays, select
from knowarm.learn.collector import Collector
from knowarm.learn.environment import ThresholdCurriculum, TorchVectorEnv
from knowarm.learn.evaluation import Metrics
from knowarm.learn.guards import FiniteGuard
from knowarm.learn.learner import Learner
from knowarm.learn.losses import Terms
from knowarm.learn.network import Loss, TrainingNetwork
from knowarm.learn.optimizer import PolicyOptimizer, resolve_precision
from knowarm.learn.parallel.processes import keep_freed_memory
from knowarm.learn.parallel.shared_tensors import TensorSpecs
from knowarm.learn.privileged import PrivilegedRecorder
from knowarm.learn.trainer import StopReason, SynchronousTrainer
from knowarm.policy import Policy
from knowarm.seeding import torch_generator


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
        seed: of the run; episodes, actions and minibatches have a stream each.
        loss: of a minibatch; picklable.
        targets: shapes and dtypes of what the loss needs besides rollout and auxiliary targets.
        recorder: records the simulator's state, if the algorithm uses it.
        auxiliary_targets: number of outputs of the auxiliary head; 0 for none.
        curriculum: of the success thresholds.
        greedy: collect with the most probable actions.
        final_values: as `Collector`.
        options: as `Trainer`.

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
        seed: int,
        loss: Loss,
        targets: TensorSpecs,
        recorder: PrivilegedRecorder | None,
        auxiliary_targets: int,
        curriculum: ThresholdCurriculum | None = None,
        greedy: bool = False,
        final_values: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(policy, seed=seed, **options)
        if env.num_envs != config.num_envs:
            raise UserError(
                f"The config's num_envs is {config.num_envs} and the environment has "
                f"{env.num_envs}; make them equal."
            )
        self._device = env.device
        if config.device == "cuda" and self._device.type != "cuda":
            raise UserError(
                f"The config's device is 'cuda' and the environment is on {self._device}: create "
                "the environment with device='cuda', or pass device='cpu' in the config."
            )
        self.config = config
        self._recorder = recorder
        self.matmul_precision = resolve_precision(config.matmul_precision, self._device)
        network = TrainingNetwork(policy.to(self._device), auxiliary_targets, seed)
        self._head = network.head
        self._learner = Learner(network, config, loss, targets, self.matmul_precision, self._device)
        self._collector = Collector(
            env, policy, seed=seed, final_values=final_values, greedy=greedy, curriculum=curriculum
        )
        self._minibatch_generator = torch_generator(seed, "minibatches", device=self._device)
        parameters = network.parameters_by_name()
        self._optimizer = PolicyOptimizer(parameters, config, self._learner.processes)
        self._guard = FiniteGuard(self.failure_folder)

    @abstractmethod
    def set_targets(self) -> None:
        """Compute the targets of the loss from the rollout."""

    def collect(self, progress: float) -> None:
        """Fill the rollout, after a fraction ``progress`` of the training."""
        self._collector.collect(self._learner.rollout, self._learner.infer, recorder=self._recorder)

    def extra_state(self) -> Arrays:
        """Return what a checkpoint holds besides the state of this class."""
        return {}

    def restore_extra(self, state: Arrays) -> None:
        """Restore the result of `extra_state`, which ``state`` contains."""

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
        parts = {
            "collector": self._collector.get_state(),
            "privileged": self._recorder.get_state() if self._recorder else {},
            "auxiliary": policy_arrays(self._head) if self._head else {},
        }
        named = {f"{part}/{k}": v for part, state in parts.items() for k, v in state.items()}
        return Checkpoint(
            policy=policy_arrays(self.policy),
            optimizer=self._optimizer.get_state(),
            state={
                "order": self._minibatch_generator.get_state().numpy(),
                **named,
                **self.extra_state(),
            },
        )

    def restore(self, checkpoint: Checkpoint) -> None:
        """See `Trainer.restore`."""
        state = checkpoint.state
        self._optimizer.set_state(checkpoint.optimizer)
        if self._head is not None:
            arrays = select(state, "auxiliary/")
            self._head.load_state_dict({k: torch.from_numpy(v) for k, v in arrays.items()})
        if self._recorder is not None:
            self._recorder.set_state(select(state, "privileged/"))
        self._collector.set_state(select(state, "collector/"))
        self._minibatch_generator.set_state(torch.from_numpy(state["order"]))
        self.restore_extra(state)

    def update(self, total_steps: int) -> Metrics:
        """Collect one rollout, learn from it, and return the metrics of both."""
        rollout = self._learner.rollout
        progress = self.step / total_steps
        rate = self.config.learning_rate_at(progress)
        self._optimizer.set_learning_rate(rate)
        environment_s, start = self._collector.environment_s, time.perf_counter()
        self.collect(progress)
        environment_s = self._collector.environment_s - environment_s
        collected = time.perf_counter()
        self.step += rollout.reward.numel()
        self._guard.check_rollout(rollout, self.step)
        if self._recorder is not None:
            self._recorder.standardize()
        self.set_targets()
        terms, norms = self._learn()
        learned = time.perf_counter()
        means = {
            name: float(torch.stack([each[name] for each in terms]).mean()) for name in terms[0]
        }
        del means["total"]
        return {
            **self._collector.statistics.take().summary(),
            **means,
            "grad_norm": float(torch.stack(norms).mean()),
            "learning_rate": rate,
            "environment_s": environment_s,
            "inference_s": collected - start - environment_s,
            "learn_s": learned - collected,
        }

    def _learn(self) -> tuple[list[Terms], list[Tensor]]:
        """Run all epochs; return the loss terms and unclipped gradient norms of all minibatches."""
        config, learner = self.config, self._learner
        terms: list[Terms] = []
        norms: list[Tensor] = []
        for _ in range(config.epochs):
            order = torch.randperm(
                config.num_envs, generator=self._minibatch_generator, device=self._device
            )
            for env_ids in order.chunk(config.minibatches):
                loss = learner.compute_gradient(env_ids)
                norm = torch.linalg.vector_norm(learner.gradient)
                self._guard.check_update(self.policy, loss, norm, self.step, learner.rollout)
                if norm > config.max_grad_norm:
                    learner.gradient.mul_(config.max_grad_norm / norm)
                self._optimizer.step()
                terms.append(loss)
                norms.append(norm)
        return terms, norms
