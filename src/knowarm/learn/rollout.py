"""Rollouts: buffers for T steps of B environments, inference that writes them, minibatches."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from knowarm.learn.algorithms import PPOConfig
from knowarm.learn.losses import PPOLossTerms, next_values, ppo_loss
from knowarm.learn.parallel.shared_tensors import TensorSpecs, zeros
from knowarm.policy import Policy, State
from knowarm.policy.encoder import orthogonal
from knowarm.seeding import torch_generator


@dataclass(frozen=True)
class Rollout:
    """Preallocated tensors of a rollout, written in place."""

    patches: Tensor  # (T, B, S, L) uint8: patches of the images; see `Policy.patches`
    facet: Tensor  # (T, B) int64: row of the knowledge table; or (T, B, K) float32: the knowledge
    episode_start: Tensor  # (T, B) bool: the image is the first of its episode
    action: Tensor  # (T, B, J) int64
    # (T, B) float32: log-probability of the action, summed over joints [nat]
    log_probability: Tensor
    value: Tensor  # (T, B) float32: value of each observation
    reward: Tensor  # (T, B) float32, unscaled
    terminated: Tensor  # (T, B) bool
    truncated: Tensor  # (T, B) bool
    final_value: Tensor  # (T, B) float32: value of the final observation where truncated, else 0
    last_value: Tensor  # (B,) float32: value of the observation after the last step
    start_h: Tensor  # (B, H) float32: hidden state before the first step
    start_c: Tensor  # (B, H) float32: cell state before the first step

    @classmethod
    def zeros(cls, steps: int, batch: int, policy: Policy) -> "Rollout":
        """Allocate a rollout of T steps of B environments on the CPU."""
        return cls(**zeros(rollout_specs(steps, batch, policy)))

    @property
    def start_state(self) -> State:
        """Recurrent state before the first step."""
        return self.start_h, self.start_c

    @property
    def done(self) -> Tensor:
        """(T, B) bool: the episode ended with this step."""
        return self.terminated | self.truncated

    def following(self, *, bootstrap_at_time_limit: bool = True) -> Tensor:
        """Return the value after each step within its episode, (T, B); see `next_values`.

        A truncated episode continues with the value of its final observation, or with 0.
        """
        ended = self.terminated if bootstrap_at_time_limit else self.done
        return next_values(self.value, self.last_value, self.final_value, ended, self.truncated)

    def first(self, steps: int) -> "Rollout":
        """Return a view of the first steps."""
        whole = {"last_value", "start_h", "start_c"}
        return Rollout(**{k: v if k in whole else v[:steps] for k, v in self.tensors().items()})

    def tensors(self) -> dict[str, Tensor]:
        """Return all tensors by name."""
        return dict(vars(self))


def rollout_specs(steps: int, batch: int, policy: Policy) -> TensorSpecs:
    """Return shapes and dtypes of the tensors of a rollout of T steps of B environments."""
    table, state = (steps, batch), (batch, policy.hidden_size)
    facet_shape, facet_dtype = policy.facet_spec
    return {
        "patches": ((*table, *policy.encoder.patch_shape), torch.uint8),
        "facet": ((*table, *facet_shape), facet_dtype),
        "episode_start": (table, torch.bool),
        "action": ((*table, policy.shape.joints), torch.int64),
        "log_probability": (table, torch.float32),
        "value": (table, torch.float32),
        "reward": (table, torch.float32),
        "terminated": (table, torch.bool),
        "truncated": (table, torch.bool),
        "final_value": (table, torch.float32),
        "last_value": ((batch,), torch.float32),
        "start_h": (state, torch.float32),
        "start_c": (state, torch.float32),
    }


@torch.no_grad()
def infer_step(
    policy: Policy, rollout: Rollout, t: int, image: Tensor, state: State, envs: slice = slice(None)
) -> tuple[Tensor, State]:
    """Run the policy for step t of the b environments ``envs``.

    ``image`` and ``state`` are those of all environments; ``facet`` and ``episode_start`` of step t
    are read from the rollout, and ``patches`` and ``value`` written to it. Returns logits (b, J, A)
    and the next state of these environments.
    """
    patches = rollout.patches[t, envs]
    patches.copy_(policy.patches(image[envs]))
    logits, values, state = policy.step(
        patches,
        rollout.facet[t, envs],
        (state[0][envs], state[1][envs]),
        rollout.episode_start[t, envs],
    )
    rollout.value[t, envs] = values
    return logits, state


@dataclass(frozen=True)
class Targets:
    """Targets of PPO's loss for one rollout."""

    advantage: Tensor  # (T, B) float32
    returns: Tensor  # (T, B) float32
    auxiliary: Tensor | None = None  # (T, B, K) float32: what the auxiliary head predicts
    teacher_actions: Tensor | None = None  # (T, B, J) int64: what the teacher would do
    teacher_weight: Tensor | None = None  # (T, B, J) float32: weights of their losses


class TrainingNetwork(nn.Module):
    """The policy, and in training only a head that predicts K auxiliary targets (0: no head)."""

    def __init__(self, policy: Policy, auxiliary_targets: int, seed: int = 0) -> None:
        super().__init__()
        self.policy = policy
        self.auxiliary_targets = auxiliary_targets
        self.head: nn.Linear | None = None
        if auxiliary_targets:
            self.head = nn.Linear(policy.fc.out_features, auxiliary_targets)
            orthogonal(self.head, 1.0, torch_generator(seed, "weights", 2))
            self.head.to(policy.fc.weight.device)

    def parameters_by_name(self) -> dict[str, nn.Parameter]:
        """Return the parameters by name, those of the head after ``auxiliary``."""
        head = self.head.named_parameters() if self.head else ()
        named = {f"auxiliary.{name}": parameter for name, parameter in head}
        return {**dict(self.policy.named_parameters()), **named}


def buffer_specs(network: TrainingNetwork, config: PPOConfig) -> TensorSpecs:
    """Return shapes and dtypes of the tensors of a rollout and its targets."""
    steps, batch = config.rollout_steps, config.num_envs
    shapes: dict[str, tuple[int, ...]] = {"advantage": (steps, batch), "returns": (steps, batch)}
    specs = dict(rollout_specs(steps, batch, network.policy))
    if config.imitation_coef:
        specs["teacher_actions"] = specs["action"]
        specs["teacher_weight"] = (specs["action"][0], torch.float32)
    if network.auxiliary_targets:
        shapes["auxiliary"] = (steps, batch, network.auxiliary_targets)
    targets = {name: (shape, torch.float32) for name, shape in shapes.items()}
    return {**specs, **targets}


def buffers(tensors: Mapping[str, Tensor]) -> tuple[Rollout, Targets]:
    """Build rollout and targets from tensors by name; others are ignored."""
    rollout, targets = (
        {name: tensors[name] for name in kind.__annotations__ if name in tensors}
        for kind in (Rollout, Targets)
    )
    return Rollout(**rollout), Targets(**targets)


def add_gradient(
    network: TrainingNetwork,
    config: PPOConfig,
    rollout: Rollout,
    targets: Targets,
    env_ids: Tensor,
    weight: float = 1.0,
) -> PPOLossTerms:
    """Add the gradient of the loss over the environments ``env_ids`` (b,) to those of the network.

    The loss has a factor ``weight``: b over the number of environments in the whole minibatch, so
    that the returned terms of a minibatch's parts add up to its own.
    """
    h, c = rollout.start_state
    logits, values, _, features = network.policy.unroll_with_features(
        rollout.patches.index_select(1, env_ids),
        rollout.facet[:, env_ids],
        (h[env_ids], c[env_ids]),
        rollout.episode_start[:, env_ids],
    )
    auxiliary = None
    if network.head is not None and targets.auxiliary is not None:
        predicted = network.head(features.float())
        error = predicted - targets.auxiliary[:, env_ids].flatten(0, 1)
        auxiliary = error.square().mean()
    lesson = {
        name: None if (tensor := getattr(targets, name)) is None else tensor[:, env_ids]
        for name in ("teacher_actions", "teacher_weight")
    }
    terms = ppo_loss(
        logits,
        values,
        rollout.action[:, env_ids],
        rollout.log_probability[:, env_ids],
        targets.advantage[:, env_ids],
        targets.returns[:, env_ids],
        clip_range=config.clip_range,
        vf_coef=config.vf_coef,
        ent_coef=config.ent_coef,
        auxiliary=auxiliary,
        auxiliary_coef=config.auxiliary_coef,
        **lesson,
        imitation_coef=config.imitation_coef,
        imitation_stay=config.imitation_stay,
        reinforcement_coef=config.reinforcement_coef,
    )
    (terms.total * weight).backward()
    return terms.scaled(weight)
