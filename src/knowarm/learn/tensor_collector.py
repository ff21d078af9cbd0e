"""A policy and a vector environment of tensors go in; rollouts come out that never left the device.

Between environment and policy there are kernel launches and nothing else: no value is looked at by
the host before the rollout is full.
"""

from typing import Any, Protocol, TypeGuard

import numpy as np
import torch
from torch import Tensor

from knowarm.learn.collector import below, check_table
from knowarm.learn.player import Player
from knowarm.learn.rollout import Rollout
from knowarm.learn.stopwatch import Stopwatch
from knowarm.learn.tensor_statistics import TensorStatistics
from knowarm.policy import Policy
from knowarm.policy.actions import log_probability, sample
from knowarm.policy.memory import State


class TensorEnvironment(Protocol):
    """A vector environment as `VectorEnvironment`, whose arguments and results are tensors.

    ``infos["final_obs"]`` is (n, H, W, 3) and valid where an episode was truncated;
    ``infos["final_info"]["is_success"]`` is (n,) bool and valid where one ended.
    """

    num_envs: int
    device: torch.device

    @property
    def max_episode_steps(self) -> int:
        """No environment is truncated twice within so many steps."""
        ...

    @property
    def facet_ids(self) -> Tensor:
        """(n,) int64: row of the knowledge table of each episode now running."""
        ...

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Tensor, dict[str, Any]]:
        """Start episodes; observations (n, H, W, 3) uint8."""
        ...

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Take actions (n, J) int64: observations, rewards, terminated, truncated, infos."""
        ...

    def get_state(self) -> dict[str, np.ndarray]:
        """Return all that is needed to go on."""
        ...

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Go on from what `get_state` returned."""
        ...


def has_tensors(env: object) -> TypeGuard[TensorEnvironment]:
    """Tell whether an environment takes and gives tensors: it then names their device."""
    return hasattr(env, "device")


class TensorCollector:
    """A `Collector` for an environment of tensors; the same numbers where the device is the CPU.

    The value of an episode's last image is wanted where the time limit cut it. Finding out where
    would mean waiting for the device, so the images are kept by environment and valued together:
    after as many steps as the shortest time between two cuts of one environment.

    Args:
        env: the vector environment; it is reset with ``seed``.
        policy: gives the recurrent state its size.
        table: (F, K) float32 knowledge on the environment's device.
        seed: of the episodes and of the drawn actions.
    """

    def __init__(self, env: TensorEnvironment, policy: Policy, table: Tensor, *, seed: int) -> None:
        self.env = env
        self.table = table
        count, device = env.num_envs, env.device
        self.statistics = TensorStatistics(count, device)
        self.generator = torch.Generator(device).manual_seed(seed)
        self._watch = Stopwatch(device)
        self._observation, _ = env.reset(seed=seed)
        self._start = torch.ones(count, dtype=torch.bool, device=device)
        self._state: State = policy.initial_state(count)
        self._cut = torch.zeros(count, dtype=torch.bool, device=device)
        self._cut_at = torch.zeros(count, dtype=torch.int64, device=device)
        self._cut_facet = torch.zeros(count, dtype=torch.int64, device=device)
        shape = (count, *policy.encoder.patch_shape)
        self._cut_patches = torch.zeros(shape, dtype=torch.uint8, device=device)
        self._cut_state: State = policy.initial_state(count)
        check_table(table, int(env.facet_ids.max()))

    @property
    def environment_s(self) -> float:
        """Time the environment's steps have taken so far [s]; waits for the device."""
        return self._watch.seconds()

    @torch.no_grad()
    def collect(self, player: Player, rollout: Rollout) -> None:
        """Fill the rollout with the next T steps of all environments."""
        steps, _ = rollout.shape
        logits = []
        rollout.start_h.copy_(self._state[0])
        rollout.start_c.copy_(self._state[1])
        rollout.final_value.zero_()
        for t in range(steps):
            rollout.facet[t] = self.env.facet_ids
            rollout.episode_start[t] = self._start
            logit, self._state = player.play(rollout, t, self._observation, self._state)
            logits.append(logit)
            rollout.action[t] = sample(logit, self.generator)
            self._watch.begin()
            self._observation, reward, terminated, truncated, infos = self.env.step(
                rollout.action[t]
            )
            self._watch.end()
            rollout.reward[t] = reward
            rollout.terminated[t] = terminated
            rollout.truncated[t] = truncated
            self._keep_cut(player.policy, rollout, t, truncated & ~terminated, infos["final_obs"])
            if (t + 1) % self.env.max_episode_steps == 0 or t + 1 == steps:
                self._value_cut(player.policy, rollout)
            success = infos["final_info"]["is_success"]
            self.statistics.add(reward, terminated | truncated, success)
            self._start = terminated | truncated
        rollout.log_probability.copy_(log_probability(torch.stack(logits), rollout.action))
        patches = player.policy.patches(self._observation)
        knowledge = self.table[self.env.facet_ids]
        _, value, _ = player.policy.step(patches, knowledge, self._state, self._start)
        rollout.last_value.copy_(value)

    def _keep_cut(
        self, policy: Policy, rollout: Rollout, t: int, cut: Tensor, image: Tensor
    ) -> None:
        """Remember image, facet and state of the environments that are cut at step t."""
        column = cut[:, None]
        self._cut_patches = torch.where(column[..., None], policy.patches(image), self._cut_patches)
        self._cut_facet = torch.where(cut, rollout.facet[t], self._cut_facet)
        self._cut_at = torch.where(cut, t, self._cut_at)
        h, c = (
            torch.where(column, now, kept)
            for now, kept in zip(self._state, self._cut_state, strict=True)
        )
        self._cut_state = (h, c)
        self._cut = self._cut | cut

    def _value_cut(self, policy: Policy, rollout: Rollout) -> None:
        """Write the values of the last images of what was cut since the last call."""
        knowledge, going_on = self.table[self._cut_facet], torch.zeros_like(self._cut)
        _, value, _ = policy.step(self._cut_patches, knowledge, self._cut_state, going_on)
        place = self._cut_at[None]
        kept = rollout.final_value.gather(0, place)[0]
        rollout.final_value.scatter_(0, place, torch.where(self._cut, value, kept)[None])
        self._cut = torch.zeros_like(self._cut)
        self._cut_at = torch.zeros_like(self._cut_at)

    def get_state(self) -> dict[str, np.ndarray]:
        """Return all that is needed to go on, the environment's state included."""
        state = {
            "observation": self._observation,
            "episode_start": self._start,
            "h": self._state[0],
            "c": self._state[1],
            "generator": self.generator.get_state(),
        }
        arrays = {name: tensor.cpu().numpy().copy() for name, tensor in state.items()}
        arrays.update({f"episode/{k}": v for k, v in self.statistics.get_state().items()})
        arrays.update({f"env/{k}": np.asarray(v) for k, v in self.env.get_state().items()})
        return arrays

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Go on from what `get_state` returned."""

        def place(name: str) -> Tensor:
            return torch.from_numpy(state[name].copy()).to(self.env.device)

        self._observation, self._start = place("observation"), place("episode_start")
        self._state = (place("h"), place("c"))
        self.generator.set_state(torch.from_numpy(state["generator"].copy()))
        self.statistics.set_state(below(state, "episode/"))
        self.env.set_state(below(state, "env/"))
