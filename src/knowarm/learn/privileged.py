"""Learning from privileged state: asymmetric critic, auxiliary targets, progress reward.

The simulator's state trains the critic and shapes the features of the image; the policy itself
never receives it, so it plays from images alone.
"""

from typing import NamedTuple, cast

import numpy as np
import torch
from torch import Tensor, nn

from knowarm.errors import UserError
from knowarm.learn.algorithms import PPOConfig
from knowarm.learn.checkpoint import select
from knowarm.learn.environment import PrivilegedVectorEnv, TeachingVectorEnv, TorchVectorEnv
from knowarm.learn.optimizer import Adam
from knowarm.policy.encoder import orthogonal
from knowarm.seeding import torch_generator

AUXILIARY_QUANTITIES = (
    "joint_position",
    "gripper_position",
    "grasp_position",
    "gripper_to_grasp",
    "grasp_matrix",
)
"""Quantities of the privileged state that the auxiliary head predicts: arm and target."""

CRITIC_WIDTH = 128
CRITIC_LEARNING_RATE = 1e-3
CRITIC_EPOCHS = 2
CRITIC_MINIBATCHES = 4

WAY_SCALE = 10.0
"""Way to the teacher's solution that is one unit of the auxiliary loss [largest steps]."""
WAY_BOUND = 2.0

SHORTEST_WAY = 0.5
"""Way at least assumed in the weights of the imitation loss [largest steps]; within it a joint
stays where it is."""

PROGRESS_PER_METRE = 100.0
PROGRESS_PER_DEGREE = 20.0 / 90.0


class PrivilegedRollout(NamedTuple):
    """Privileged states of a rollout, written in place by the collector."""

    state: Tensor  # (T, B, D) float32: before each step
    next_state: Tensor  # (T, B, D) float32: after each step, within the same episode
    # (T, B, J) int64: what the teacher would do instead of each step; None without a teacher
    teacher_actions: Tensor | None = None
    # (T, B, J) float32: way to the teacher's solution before each step, in largest steps
    teacher_way: Tensor | None = None


class RunningNormalizer:
    """Standardizes columns by their mean and deviation so far, clipped to +-5."""

    def __init__(self, columns: int, device: torch.device) -> None:
        self.count = torch.zeros((), dtype=torch.float64, device=device)
        self.mean = torch.zeros(columns, dtype=torch.float64, device=device)
        self.square = torch.zeros(columns, dtype=torch.float64, device=device)
        """Sum of squared deviations from the mean."""

    def update(self, values: Tensor) -> None:
        """Take values (N, D) into account (Chan, Golub and LeVeque 1979)."""
        values = values.double()
        count, mean = len(values), values.mean(0)
        total = self.count + count
        difference = mean - self.mean
        between = difference.square() * self.count * count / total
        self.square = self.square + (values - mean).square().sum(0) + between
        self.mean = self.mean + difference * count / total
        self.count = total

    def __call__(self, values: Tensor) -> Tensor:
        """Standardize values (..., D)."""
        deviation = (self.square / self.count.clamp(min=1)).sqrt().clamp(min=1e-6)
        return ((values - self.mean.float()) / deviation.float()).clamp(-5, 5)

    def get_state(self) -> dict[str, np.ndarray]:
        """Return all that `set_state` needs."""
        return {name: tensor.cpu().numpy().copy() for name, tensor in vars(self).items()}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Continue from the result of `get_state`."""
        for name, tensor in vars(self).items():
            setattr(self, name, torch.from_numpy(state[name].copy()).to(tensor.device))


class StateCritic:
    """Critic on the privileged state (Pinto et al. 2017): three layers with their own Adam."""

    def __init__(self, columns: int, device: torch.device, seed: int) -> None:
        weights = torch_generator(seed, "weights", 1)
        self.network = nn.Sequential(
            nn.Linear(columns, CRITIC_WIDTH),
            nn.ReLU(),
            nn.Linear(CRITIC_WIDTH, CRITIC_WIDTH),
            nn.ReLU(),
            nn.Linear(CRITIC_WIDTH, 1),
        )
        # The small last layer makes the first values nearly zero.
        layers = [layer for layer in self.network if isinstance(layer, nn.Linear)]
        for layer, gain in zip(layers, (2**0.5, 2**0.5, 0.01), strict=True):
            orthogonal(layer, gain, weights)
        self.network.to(device)
        self._optimizer = Adam(self.network.parameters(), lr=CRITIC_LEARNING_RATE, fused=True)
        self._generator = torch_generator(seed, "minibatches", 1, device=device)

    @torch.no_grad()
    def __call__(self, state: Tensor) -> Tensor:
        """Return the values (...) of standardized states (..., D)."""
        return cast(Tensor, self.network(state).squeeze(-1))

    def fit(self, state: Tensor, returns: Tensor) -> None:
        """Regress the returns (N,) on standardized states (N, D)."""
        for _ in range(CRITIC_EPOCHS):
            order = torch.randperm(len(state), generator=self._generator, device=state.device)
            for rows in order.chunk(CRITIC_MINIBATCHES):
                self._optimizer.zero_grad()
                error = self.network(state[rows]).squeeze(-1) - returns[rows]
                error.square().mean().backward()
                self._optimizer.step()

    def get_state(self) -> dict[str, np.ndarray]:
        """Return all that `set_state` needs."""
        state = {"generator": self._generator.get_state()}
        for name, parameter in self.network.named_parameters():
            state[f"{name}/value"] = parameter.detach()
            state |= {f"{name}/{k}": v for k, v in self._optimizer.state[parameter].items()}
        return {name: tensor.cpu().numpy().copy() for name, tensor in state.items()}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Continue from the result of `get_state`."""
        self._generator.set_state(torch.from_numpy(state["generator"].copy()))
        for name, parameter in self.network.named_parameters():
            arrays = select(state, f"{name}/").items()
            values = {k: torch.from_numpy(v.copy()).to(parameter.device) for k, v in arrays}
            parameter.data.copy_(values.pop("value"))
            self._optimizer.state[parameter] = values


class PrivilegedLearning:
    """What PPO computes from the privileged states of its rollouts.

    Attributes:
        rollout: written by the collector.
        critic: values the states; None with the critic on images.
    """

    def __init__(self, config: PPOConfig, env: PrivilegedVectorEnv, seed: int) -> None:
        columns: tuple[str, ...] | None = getattr(env, "privileged_columns", None)
        if columns is None:
            raise UserError(
                f"{type(env).__name__} reports no privileged state, which critic='state', "
                "auxiliary_coef and progress_coef need: implement "
                "knowarm.learn.PrivilegedVectorEnv, or leave them at their defaults."
            )
        env.report_privileged_state = True
        teacher = {}
        if config.imitation_coef:
            lessons = teaching_env(env).teach()
            names, table = ("teacher_actions", "teacher_way"), (config.rollout_steps, 1, 1)
            teacher = {k: v.repeat(table) for k, v in zip(names, lessons, strict=True)}
        shape = (config.rollout_steps, config.num_envs, len(columns))
        self.rollout = PrivilegedRollout(
            *(torch.zeros(shape, device=env.device) for _ in ("state", "next_state")), **teacher
        )
        uses_critic = config.critic == "state"
        self.critic = StateCritic(len(columns), env.device, seed) if uses_critic else None
        self._progress_coef = config.progress_coef
        self._weighted_way = config.imitation_way
        self._auxiliary = torch.tensor(auxiliary_columns(columns), device=env.device)
        if config.progress_coef:
            if not {"distance/0", "angle/0"} <= set(columns):
                raise UserError(
                    "progress_coef needs the privileged columns distance/0 and angle/0; "
                    f"{type(env).__name__} has {', '.join(columns)}. Add them, or set it to 0."
                )
            self._distance, self._angle = columns.index("distance/0"), columns.index("angle/0")
        self._normalizer = RunningNormalizer(len(columns), env.device)
        self._standardized = self.rollout

    def update(self) -> None:
        """Standardize the states of a new rollout; call it first."""
        rollout = self.rollout
        self._normalizer.update(rollout.state.flatten(0, 1))
        self._standardized = rollout._replace(
            state=self._normalizer(rollout.state), next_state=self._normalizer(rollout.next_state)
        )

    def progress_reward(self) -> Tensor:
        """Return what the steps gained in distance and angle as a reward, (T, B)."""
        gained = self.rollout.state - self.rollout.next_state
        return self._progress_coef * (
            PROGRESS_PER_METRE * gained[..., self._distance]
            + PROGRESS_PER_DEGREE * gained[..., self._angle]
        )

    def auxiliary_targets(self) -> Tensor:
        """Return the standardized targets of the auxiliary head, (T, B, K).

        With a teacher, they include the way to its solution.
        """
        targets = self._standardized.state.index_select(-1, self._auxiliary)
        way = self.rollout.teacher_way
        if way is None:
            return targets
        return torch.cat((targets, (way / WAY_SCALE).clamp(-WAY_BOUND, WAY_BOUND)), -1)

    def teacher_weight(self) -> Tensor:
        """Return the weights of the imitation loss, (T, B, J), with a mean of 1.

        They are proportional to a joint's way, at least `SHORTEST_WAY` and at most
        ``imitation_way`` steps: a joint that moves the wrong way is worse far from the solution.
        """
        way = self.rollout.teacher_way
        assert way is not None
        if self._weighted_way is None:
            return torch.ones_like(way)
        way = way.abs().clamp(SHORTEST_WAY, self._weighted_way)
        return way / way.mean()

    def values(self) -> tuple[Tensor, Tensor]:
        """Return the critic's values before and after each step, (T, B) each."""
        assert self.critic is not None
        return self.critic(self._standardized.state), self.critic(self._standardized.next_state)

    def fit(self, returns: Tensor) -> None:
        """Train the critic, if there is one, on the returns (T, B)."""
        if self.critic is not None:
            self.critic.fit(self._standardized.state.flatten(0, 1), returns.flatten())

    def get_state(self) -> dict[str, np.ndarray]:
        """Return all that `set_state` needs."""
        state = {f"normalizer/{k}": v for k, v in self._normalizer.get_state().items()}
        critic = self.critic.get_state() if self.critic else {}
        return state | {f"critic/{k}": v for k, v in critic.items()}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Continue from the result of `get_state`."""
        for name, part in (("normalizer", self._normalizer), ("critic", self.critic)):
            if part is not None:
                part.set_state(select(state, f"{name}/"))


def auxiliary_columns(columns: tuple[str, ...]) -> list[int]:
    """Return the indices of the columns that the auxiliary head predicts."""
    return [i for i, name in enumerate(columns) if name.split("/")[0] in AUXILIARY_QUANTITIES]


def teaching_env(env: TorchVectorEnv) -> TeachingVectorEnv:
    """Return an environment as one with a teacher; an error if it has none."""
    if not hasattr(env, "teach"):
        raise UserError(
            f"{type(env).__name__} has no teacher, which imitation_coef and practice_until need: "
            "implement knowarm.learn.TeachingVectorEnv, or leave them at 0."
        )
    return cast(TeachingVectorEnv, env)
