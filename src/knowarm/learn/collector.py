"""A policy and a vector environment go in; rollouts come out, episodes running on between them."""

import time

import numpy as np
import torch
from torch import Tensor

from knowarm.errors import UserError
from knowarm.learn.environment import VectorEnvironment
from knowarm.learn.player import Player
from knowarm.learn.rollout import Rollout
from knowarm.learn.statistics import EpisodeStatistics
from knowarm.policy import Policy
from knowarm.policy.actions import log_probability, sample
from knowarm.policy.memory import State


class Collector:
    """Steps the environments with the policy and remembers where each of them stands.

    Args:
        env: the vector environment; it is reset with ``seed``.
        policy: gives the recurrent state its size; `collect` takes what plays.
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
        check_table(table, int(np.max(env.facet_ids)))

    @torch.no_grad()
    def collect(self, player: Player, rollout: Rollout) -> None:
        """Fill the rollout with the next T steps of all environments."""
        steps, _ = rollout.shape
        logits = []
        rollout.start_h.copy_(self._state[0])
        rollout.start_c.copy_(self._state[1])
        for t in range(steps):
            rollout.facet[t] = self._facets()
            rollout.episode_start[t] = torch.from_numpy(self._start)
            image = torch.from_numpy(self._observation)
            logit, self._state = player.play(rollout, t, image, self._state)
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
                final = np.stack([infos["final_obs"][i] for i in cut])
                state = (self._state[0][cut], self._state[1][cut])
                going_on = np.zeros(len(cut), np.bool_)
                rollout.final_value[t, cut] = self._value(
                    player.policy, final, rollout.facet[t, cut], state, going_on
                )
            self.statistics.add(rewards, terminated, truncated, infos)
            self._start = terminated | truncated
        rollout.log_probability.copy_(log_probability(torch.stack(logits), rollout.action))
        rollout.last_value.copy_(
            self._value(player.policy, self._observation, self._facets(), self._state, self._start)
        )

    def _facets(self) -> Tensor:
        return torch.from_numpy(np.asarray(self.env.facet_ids, np.int64))

    def _value(
        self, policy: Policy, image: np.ndarray, facet: Tensor, state: State, start: np.ndarray
    ) -> Tensor:
        """Values (n,) of observations (n, H, W, 3)."""
        patches = policy.patches(torch.from_numpy(image))
        _, value, _ = policy.step(patches, self.table[facet], state, torch.from_numpy(start))
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


def check_table(table: Tensor, highest: int) -> None:
    """Refuse a knowledge table without a row for the highest facet that is shown.

    Raises:
        UserError: naming both.
    """
    if highest >= len(table):
        raise UserError(
            f"The knowledge table has {len(table)} rows and the environment shows facet "
            f"{highest}; build the table from the facets of this environment."
        )


def below(state: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """Return the entries whose names start with ``prefix``, without it."""
    return {k[len(prefix) :]: v for k, v in state.items() if k.startswith(prefix)}
