"""A policy and a vector environment go in; rollouts come out, episodes running on between them."""

import time

import numpy as np
import torch
from torch import Tensor

from knowarm.errors import UserError
from knowarm.learn.environment import VectorEnvironment
from knowarm.learn.rollout import Rollout
from knowarm.learn.statistics import EpisodeStatistics
from knowarm.policy import Policy
from knowarm.policy.actions import log_probability, sample
from knowarm.policy.memory import State


class Collector:
    """Steps the environments with the policy and remembers where each of them stands.

    Args:
        env: the vector environment; it is reset with ``seed``.
        policy: gives the recurrent state its size; `collect` takes the policy to play.
        table: (F, K) float32 knowledge, one row a facet.
        seed: of the episodes and of the drawn actions.

    Attributes:
        environment_s: time the environments' steps have taken so far [s].
    """

    def __init__(self, env: VectorEnvironment, policy: Policy, table: Tensor, *, seed: int) -> None:
        self.env = env
        self.table = table
        self.statistics = EpisodeStatistics(env.num_envs)
        self.generator = torch.Generator().manual_seed(seed)
        self.environment_s = 0.0
        self._observation, _ = env.reset(seed=seed)
        self._start = np.ones(env.num_envs, bool)
        self._state: State = policy.initial_state(env.num_envs)
        highest = int(np.max(env.facet_ids))
        if highest >= len(table):
            raise UserError(
                f"The knowledge table has {len(table)} rows and the environment shows facet "
                f"{highest}; build the table from the facets of this environment."
            )

    @property
    def image_shape(self) -> tuple[int, ...]:
        """(H, W, 3) of one observation."""
        return self._observation.shape[1:]

    @torch.no_grad()
    def collect(self, policy: Policy, rollout: Rollout) -> None:
        """Fill the rollout with the next T steps of all environments."""
        steps, _ = rollout.shape
        logits = []
        rollout.start_state = (self._state[0].clone(), self._state[1].clone())
        for t in range(steps):
            rollout.image[t] = torch.from_numpy(self._observation)
            rollout.facet[t] = torch.from_numpy(np.asarray(self.env.facet_ids, np.int64))
            rollout.episode_start[t] = torch.from_numpy(self._start)
            logit, rollout.value[t], self._state = policy.step(
                rollout.image[t],
                self.table[rollout.facet[t]],
                self._state,
                rollout.episode_start[t],
            )
            logits.append(logit)
            rollout.action[t] = sample(logit, self.generator)
            actions, begin = rollout.action[t].numpy(), time.perf_counter()
            self._observation, rewards, terminated, truncated, infos = self.env.step(actions)
            self.environment_s += time.perf_counter() - begin
            rollout.reward[t] = torch.from_numpy(np.asarray(rewards, np.float32))
            rollout.terminated[t] = torch.from_numpy(terminated)
            rollout.truncated[t] = torch.from_numpy(truncated)
            rollout.final_value[t] = 0.0
            cut = np.flatnonzero(truncated & ~terminated)
            if len(cut):
                rollout.final_value[t, cut] = self._value_of_final(
                    policy, np.stack([infos["final_obs"][i] for i in cut]), rollout.facet[t], cut
                )
            self.statistics.add(rewards, terminated, truncated, infos)
            self._start = terminated | truncated
        rollout.log_probability.copy_(log_probability(torch.stack(logits), rollout.action))
        _, rollout.last_value, _ = policy.step(
            torch.from_numpy(self._observation),
            self.table[torch.from_numpy(np.asarray(self.env.facet_ids, np.int64))],
            self._state,
            torch.from_numpy(self._start),
        )

    def _value_of_final(
        self, policy: Policy, observation: np.ndarray, facet: Tensor, cut: np.ndarray
    ) -> Tensor:
        """Value of the final observations (n, H, W, 3) of the environments ``cut``."""
        state = (self._state[0][cut], self._state[1][cut])
        going_on = torch.zeros(len(cut), dtype=torch.bool)
        _, value, _ = policy.step(
            torch.from_numpy(observation), self.table[facet[cut]], state, going_on
        )
        return value

    def get_state(self) -> dict[str, np.ndarray]:
        """Return all that is needed to go on to the byte, the environment's state included."""
        state = {
            "observation": self._observation,
            "episode_start": self._start,
            "h": self._state[0].numpy(),
            "c": self._state[1].numpy(),
            "generator": self.generator.get_state().numpy(),
        }
        state = {name: np.array(value) for name, value in state.items()}
        state.update({f"episode/{k}": v for k, v in self.statistics.get_state().items()})
        state.update({f"env/{k}": np.asarray(v) for k, v in self.env.get_state().items()})
        return state

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Go on from what `get_state` returned."""
        self._observation = state["observation"].copy()
        self._start = state["episode_start"].copy()
        self._state = (torch.from_numpy(state["h"].copy()), torch.from_numpy(state["c"].copy()))
        self.generator.set_state(torch.from_numpy(state["generator"].copy()))
        self.statistics.set_state(below(state, "episode/"))
        self.env.set_state(below(state, "env/"))


def below(state: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """Return the entries whose names start with ``prefix``, without it."""
    return {k[len(prefix) :]: v for k, v in state.items() if k.startswith(prefix)}
