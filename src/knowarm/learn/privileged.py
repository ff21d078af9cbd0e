"""Learning from privileged state: recorder, auxiliary targets, asymmetric critic.

The simulator's state trains the critic and shapes the features of the image; the policy itself
never receives it, so it plays from images alone.
"""

from typing import cast

import torch
from torch import Tensor, nn

from knowarm.errors import UserError
from knowarm.learn.checkpoint import Arrays, prefixed, select, to_arrays, to_tensors
from knowarm.learn.environment import Infos, PrivilegedVectorEnv, TorchVectorEnv
from knowarm.learn.optimizer import Adam
from knowarm.policy.encoder import RELU_GAIN, orthogonal
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
        count = len(values)
        mean = values.mean(0)
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

    def get_state(self) -> Arrays:
        """Return all that `set_state` needs."""
        return to_arrays(vars(self))

    def set_state(self, state: Arrays) -> None:
        """Continue from the result of `get_state`."""
        tensors = to_tensors(state, self.count.device)
        for name in vars(self):
            setattr(self, name, tensors[name])


class StateCritic:
    """Critic on the privileged state (Pinto et al. 2017): three layers with their own Adam."""

    def __init__(self, columns: int, device: torch.device, seed: int) -> None:
        weights = torch_generator(seed, "weights", 1)
        first = nn.Linear(columns, CRITIC_WIDTH)
        second = nn.Linear(CRITIC_WIDTH, CRITIC_WIDTH)
        last = nn.Linear(CRITIC_WIDTH, 1)
        orthogonal(first, RELU_GAIN, weights)
        orthogonal(second, RELU_GAIN, weights)
        orthogonal(last, 0.01, weights)  # so that the first values are nearly zero
        network = nn.Sequential(first, nn.ReLU(), second, nn.ReLU(), last)
        self.network = network.to(device)
        self._optimizer = Adam(
            self.network.parameters(), lr=CRITIC_LEARNING_RATE, fused=True
        )
        self._generator = torch_generator(seed, "minibatches", 1, device=device)

    @torch.no_grad()
    def __call__(self, state: Tensor) -> Tensor:
        """Return the values (...) of standardized states (..., D)."""
        return cast(Tensor, self.network(state).squeeze(-1))

    def fit(self, state: Tensor, returns: Tensor) -> None:
        """Regress the returns (N,) on standardized states (N, D)."""
        for _ in range(CRITIC_EPOCHS):
            order = torch.randperm(
                len(state), generator=self._generator, device=state.device
            )
            for rows in order.chunk(CRITIC_MINIBATCHES):
                self._optimizer.zero_grad()
                error = self.network(state[rows]).squeeze(-1) - returns[rows]
                error.square().mean().backward()
                self._optimizer.step()

    def get_state(self) -> Arrays:
        """Return all that `set_state` needs."""
        state = to_arrays({"generator": self._generator.get_state()})
        for name, parameter in self.network.named_parameters():
            tensors = {"value": parameter, **self._optimizer.state[parameter]}
            state |= prefixed(f"{name}/", to_arrays(tensors))
        return state

    def set_state(self, state: Arrays) -> None:
        """Continue from the result of `get_state`."""
        self._generator.set_state(torch.tensor(state["generator"]))
        for name, parameter in self.network.named_parameters():
            tensors = to_tensors(select(state, f"{name}/"), parameter.device)
            parameter.data.copy_(tensors.pop("value"))
            self._optimizer.state[parameter] = tensors


class PrivilegedRecorder:
    """Records the privileged states of a rollout; the collector calls it around each step.

    Attributes:
        columns: names of the D columns.
        state: (T, B, D) float32, before each step.
        next_state: (T, B, D) float32, after each step, within the same episode.
        standardized: the same two by the states so far, after `standardize`.
        normalizer: knows the states so far.
    """

    def __init__(self, env: TorchVectorEnv, steps: int) -> None:
        if not hasattr(env, "privileged_columns"):
            raise UserError(
                f"{type(env).__name__} reports no privileged state, which the algorithm's critic, "
                "auxiliary_coef, progress_coef and teacher need: implement "
                "knowarm.learn.PrivilegedVectorEnv, or train without them."
            )
        self.env = cast(PrivilegedVectorEnv, env)
        self.env.report_privileged_state = True
        self.columns = self.env.privileged_columns
        shape = (steps, env.num_envs, len(self.columns))
        self.state = torch.zeros(shape, device=env.device)
        self.next_state = torch.zeros(shape, device=env.device)
        self.standardized = (self.state, self.next_state)
        auxiliary = auxiliary_columns(self.columns)
        self._auxiliary = torch.tensor(auxiliary, device=env.device)
        self.normalizer = RunningNormalizer(len(self.columns), env.device)

    @property
    def auxiliary_targets(self) -> int:
        """Number of targets of the auxiliary head."""
        return len(self._auxiliary)

    def before_step(self, t: int) -> None:
        """Record the state before step t."""
        self.state[t] = self.env.privileged_state

    def after_step(self, t: int, infos: Infos) -> None:
        """Record the state after step t."""
        self.next_state[t] = infos["final_privileged_state"]

    def standardize(self) -> None:
        """Standardize the states of a new rollout."""
        self.normalizer.update(self.state.flatten(0, 1))
        self.standardized = (
            self.normalizer(self.state),
            self.normalizer(self.next_state),
        )

    def targets(self) -> Tensor:
        """Return the standardized targets of the auxiliary head, (T, B, K)."""
        return self.standardized[0].index_select(-1, self._auxiliary)


def auxiliary_columns(columns: tuple[str, ...]) -> list[int]:
    """Return the indices of the columns that the auxiliary head predicts."""
    return [
        i
        for i, name in enumerate(columns)
        if name.split("/")[0] in AUXILIARY_QUANTITIES
    ]
