"""Rollout collector: steps environments, fills rollouts, counts the episodes that end."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from knowarm.learn.checkpoint import select
from knowarm.learn.environment import (
    Infos,
    ThresholdCurriculum,
    TorchVectorEnv,
)
from knowarm.learn.privileged import PrivilegedRecorder
from knowarm.learn.rollout import Rollout, infer_step
from knowarm.policy import Policy, State
from knowarm.policy.policy import log_probability, sample
from knowarm.seeding import derive_seed, torch_generator


@dataclass(frozen=True)
class FinishedEpisodes:
    """Episodes that ended, in order of time and environment; arrays (N,)."""

    episode_return: np.ndarray  # Undiscounted sum of rewards, float64
    length: np.ndarray  # Number of steps, int64
    success: np.ndarray  # Whether the episode ended in success, bool

    def summary(self) -> dict[str, float]:
        """Return the number of episodes and, if there are any, their means."""
        count = len(self.length)
        if count == 0:
            return {"episodes": 0}
        return {
            "episodes": count,
            "return_mean": float(self.episode_return.mean()),
            "length_mean": float(self.length.mean()),
            "success": float(self.success.mean()),
        }


class EpisodeStatistics:
    """Accumulates rewards and steps of the running episodes of n environments."""

    def __init__(self, num_envs: int, device: torch.device) -> None:
        self._return = torch.zeros(num_envs, dtype=torch.float64, device=device)
        self._length = torch.zeros(num_envs, dtype=torch.int64, device=device)
        self._steps: list[tuple[Tensor, Tensor, Tensor, Tensor]] = []

    def add(self, reward: Tensor, done: Tensor, success: Tensor) -> None:
        """Add one step's results, (n,) each; ``success`` is read where ``done``."""
        self._return = self._return + reward
        self._length = self._length + 1
        self._steps.append((done, self._return, self._length, success & done))
        self._return = torch.where(done, 0, self._return)
        self._length = torch.where(done, 0, self._length)

    def take(self, where: Tensor | None = None) -> FinishedEpisodes:
        """Return the episodes that ended since the last call, in the steps ``where`` (t, n)."""
        if not self._steps:
            return FinishedEpisodes(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, bool))
        done, returns, lengths, success = (
            torch.stack(column).cpu().numpy() for column in zip(*self._steps, strict=True)
        )
        self._steps = []
        done = done if where is None else done & where.cpu().numpy()
        return FinishedEpisodes(returns[done], lengths[done], success[done].astype(bool))

    def get_state(self) -> dict[str, np.ndarray]:
        """Return the sums of the running episodes; requires that `take` was called."""
        assert not self._steps
        return {
            "return": self._return.cpu().numpy().copy(),
            "length": self._length.cpu().numpy().copy(),
        }

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Continue from the result of `get_state`."""
        self._return.copy_(torch.from_numpy(state["return"]))
        self._length.copy_(torch.from_numpy(state["length"]))


Infer = Callable[[Rollout, int, Tensor, State], tuple[Tensor, State]]
"""Inference of one step; arguments and results as `infer_step`."""


class Collector:
    """Steps the environments with the policy; episodes continue from one rollout to the next.

    ``stream`` tells several collectors of a run apart (A3C: worker, number of its restarts).
    Without ``final_values`` neither the last images of truncated episodes nor those after the last
    step are valued, so an environment with the attribute ``report_final_observations`` need not
    draw the former. ``greedy`` collectors act by the most probable actions, as in evaluations.

    Attributes:
        environment_s: total time of the environments' steps [s].
    """

    def __init__(
        self,
        env: TorchVectorEnv,
        policy: Policy,
        *,
        seed: int,
        stream: tuple[int, ...] = (),
        final_values: bool = True,
        greedy: bool = False,
        curriculum: ThresholdCurriculum | None = None,
    ) -> None:
        self.env = env
        self.policy = policy
        self.curriculum = curriculum
        self.statistics = EpisodeStatistics(env.num_envs, env.device)
        self.generator = torch_generator(seed, "actions", *stream, device=env.device)
        self.environment_s = 0.0
        self._image, _ = env.reset(seed=derive_seed(seed, "episodes", *stream))
        self._start = torch.ones(env.num_envs, dtype=torch.bool, device=env.device)
        self._state: State = policy.initial_state(env.num_envs)
        self._final_values = final_values
        self._greedy = greedy
        if not final_values and hasattr(env, "report_final_observations"):
            env.report_final_observations = False
        policy.check_knowledge(env.knowledge)

    @torch.no_grad()
    def collect(
        self,
        rollout: Rollout,
        infer: Infer | None = None,
        *,
        until_episode_end: bool = False,
        recorder: PrivilegedRecorder | None = None,
    ) -> int:
        """Fill a rollout with the next T steps of all environments, or until each ended an episode.

        Returns the number of steps t; only the rollout's first t rows are valid (`Rollout.first`).
        """
        infer = infer or partial(infer_step, self.policy)
        logits: list[Tensor] = []
        rollout.start_h.copy_(self._state[0])
        rollout.start_c.copy_(self._state[1])
        rollout.final_value.zero_()
        ended = torch.zeros_like(self._start)
        for t in range(len(rollout.reward)):
            if recorder is not None:
                recorder.before_step(t)
            rollout.knowledge[t] = self.env.knowledge
            rollout.episode_start[t] = self._start
            logit, self._state = infer(rollout, t, self._image, self._state)
            logits.append(logit)
            rollout.action[t] = logit.argmax(-1) if self._greedy else sample(logit, self.generator)
            start = time.perf_counter()
            self._image, reward, terminated, truncated, infos = self.env.step(rollout.action[t])
            self.environment_s += time.perf_counter() - start
            rollout.reward[t] = reward
            rollout.terminated[t] = terminated
            rollout.truncated[t] = truncated
            if self._final_values:
                self._add_final_values(rollout, t, truncated & ~terminated, infos)
            self._start = terminated | truncated
            if recorder is not None:
                recorder.after_step(t, infos)
            success = infos.get("final_info", {}).get("is_success", terminated)
            self.statistics.add(reward, self._start, success)
            if until_episode_end and bool((ended := ended | self._start).all()):
                break
        count = len(logits)
        stacked, knowledge = torch.stack(logits), self.env.knowledge
        rollout.log_probability[:count] = log_probability(stacked, rollout.action[:count])
        if self._final_values and not self.is_at_start:
            _, value, _ = self.policy.step(self._image, knowledge, self._state, self._start)
            rollout.last_value.copy_(value)
        return count

    @property
    def is_at_start(self) -> bool:
        """Whether all environments are at the start of an episode."""
        return bool(self._start.all())

    def restart(self, seed: int | None = None) -> Tensor:
        """Start new episodes in all environments; return their images.

        Args:
            seed: of new streams of episodes; None continues the present ones.
        """
        self._image, _ = self.env.reset(seed=seed)
        self._start = torch.ones_like(self._start)
        self.statistics = EpisodeStatistics(self.env.num_envs, self.env.device)
        return self._image

    def _add_final_values(self, rollout: Rollout, t: int, cut: Tensor, infos: Infos) -> None:
        """Value the final observations of step t where ``cut`` (B,): truncated, not terminated."""
        ids = cut.nonzero().squeeze(1)
        if len(ids):
            image, start = infos["final_obs"][ids], torch.zeros_like(cut[ids])
            state = (self._state[0][ids], self._state[1][ids])
            _, value, _ = self.policy.step(image, rollout.knowledge[t, ids], state, start)
            rollout.final_value[t, ids] = value

    def get_state(self) -> dict[str, np.ndarray]:
        """Return all that `set_state` needs to continue identically, environments included."""
        tensors = {
            "observation": self._image,
            "episode_start": self._start,
            "h": self._state[0],
            "c": self._state[1],
        }
        state = {name: tensor.cpu().numpy().copy() for name, tensor in tensors.items()}
        state.update({f"episode/{k}": v for k, v in self.statistics.get_state().items()})
        state.update(self.get_state_between_episodes())
        state.update({f"env/{k}": np.asarray(v) for k, v in self.env.get_state().items()})
        return state

    def get_state_between_episodes(self) -> dict[str, np.ndarray]:
        """Return all that is needed where the next rollout starts new streams of episodes."""
        state = {"generator": self.generator.get_state().cpu().numpy().copy()}
        if self.curriculum is not None and self.curriculum.is_used:
            state["threshold_factor"] = np.array(self.curriculum.factor)
        return state

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Continue from the result of `get_state`."""

        def place(name: str) -> Tensor:
            return torch.from_numpy(state[name].copy()).to(self.env.device)

        self._image, self._start = place("observation"), place("episode_start")
        self._state = (place("h"), place("c"))
        self.statistics.set_state(select(state, "episode/"))
        self.set_state_between_episodes(state)
        self.env.set_state(select(state, "env/"))

    def set_state_between_episodes(self, state: dict[str, np.ndarray]) -> None:
        """Continue from the result of `get_state_between_episodes`."""
        self.generator.set_state(torch.from_numpy(state["generator"].copy()))
        if self.curriculum is not None and self.curriculum.is_used:
            self.curriculum.factor = float(state["threshold_factor"])
