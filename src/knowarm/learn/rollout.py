"""Rollouts, T steps of B environments, and the collector that fills them."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from knowarm.learn.checkpoint import Arrays, Tensors, prefixed, select, to_arrays
from knowarm.learn.environment import Infos, TorchVectorEnv
from knowarm.learn.losses import next_values
from knowarm.learn.parallel.shared_tensors import TensorSpecs, zeros
from knowarm.learn.privileged import PrivilegedRecorder
from knowarm.policy import Policy, State
from knowarm.policy.policy import log_probability, sample
from knowarm.seeding import derive_seed, torch_generator

WITHOUT_STEPS = {"last_value", "start_h", "start_c"}
"""Fields of a rollout that have no axis of time."""


@dataclass(frozen=True)
class Rollout:
    """Preallocated tensors of a rollout, written in place."""

    patches: Tensor  # (T, B, S, L) uint8: patches of the images; see `Policy.patches`
    knowledge: Tensor  # (T, B, K) float32: knowledge of the episode
    episode_start: Tensor  # (T, B) bool: the image is the first of its episode
    action: Tensor  # (T, B, J) int64
    # (T, B) float32: log-probability of the action, summed over joints [nat]
    log_probability: Tensor
    value: Tensor  # (T, B) float32: value of each observation
    reward: Tensor  # (T, B) float32, unscaled
    terminated: Tensor  # (T, B) bool
    truncated: Tensor  # (T, B) bool
    # (T, B) float32: value of the final observation where truncated, else 0
    final_value: Tensor
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
        return next_values(
            self.value, self.last_value, self.final_value, ended, self.truncated
        )

    def first(self, steps: int) -> "Rollout":
        """Return a view of the first steps."""
        tensors = self.tensors()
        for name in tensors.keys() - WITHOUT_STEPS:
            tensors[name] = tensors[name][:steps]
        return Rollout(**tensors)

    def of(self, env_ids: Tensor) -> "Rollout":
        """Return a copy of the environments ``env_ids`` (b,)."""
        tensors = {}
        for name, tensor in self.tensors().items():
            axis = 0 if name in WITHOUT_STEPS else 1
            tensors[name] = tensor.index_select(axis, env_ids)
        return Rollout(**tensors)

    def tensors(self) -> Tensors:
        """Return all tensors by name."""
        return dict(vars(self))


def rollout_specs(steps: int, batch: int, policy: Policy) -> TensorSpecs:
    """Return shapes and dtypes of the tensors of a rollout of T steps of B environments."""
    table = (steps, batch)
    flag = (table, torch.bool)
    number = (table, torch.float32)
    state = ((batch, policy.hidden_size), torch.float32)
    return {
        "patches": ((*table, *policy.encoder.patch_shape), torch.uint8),
        "knowledge": ((*table, policy.knowledge_width), torch.float32),
        "episode_start": flag,
        "action": ((*table, policy.shape.joints), torch.int64),
        "log_probability": number,
        "value": number,
        "reward": number,
        "terminated": flag,
        "truncated": flag,
        "final_value": number,
        "last_value": ((batch,), torch.float32),
        "start_h": state,
        "start_c": state,
    }


@torch.no_grad()
def infer_step(
    policy: Policy,
    rollout: Rollout,
    t: int,
    image: Tensor,
    state: State,
    envs: slice = slice(None),
) -> tuple[Tensor, State]:
    """Run the policy for step t of the b environments ``envs``.

    ``image`` and ``state`` are those of all environments; ``knowledge`` and ``episode_start`` of
    step t are read from the rollout, and ``patches`` and ``value`` written to it. Returns logits
    (b, J, A) and the next state of these environments.
    """
    patches = rollout.patches[t, envs]
    patches.copy_(policy.patches(image[envs]))
    logits, values, state = policy.step(
        patches,
        rollout.knowledge[t, envs],
        (state[0][envs], state[1][envs]),
        rollout.episode_start[t, envs],
    )
    rollout.value[t, envs] = values
    return logits, state


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
            none = np.zeros(0, np.int64)
            return FinishedEpisodes(np.zeros(0), none, none.astype(bool))
        columns = zip(*self._steps, strict=True)
        self._steps = []
        done, returns, lengths, success = [
            torch.stack(rows).cpu().numpy() for rows in columns
        ]
        if where is not None:
            done = done & where.cpu().numpy()
        return FinishedEpisodes(returns[done], lengths[done], success[done])

    def get_state(self) -> Arrays:
        """Return the sums of the running episodes; requires that `take` was called."""
        assert not self._steps
        return to_arrays({"return": self._return, "length": self._length})

    def set_state(self, state: Arrays) -> None:
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
        environment_s: time of the environments' steps, since it was set to 0 [s].
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
    ) -> None:
        self.env = env
        self.policy = policy
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
        all_logits: list[Tensor] = []
        rollout.start_h.copy_(self._state[0])
        rollout.start_c.copy_(self._state[1])
        rollout.final_value.zero_()
        ended = torch.zeros_like(self._start)
        for t in range(len(rollout.reward)):
            if recorder is not None:
                recorder.before_step(t)
            rollout.knowledge[t] = self.env.knowledge
            rollout.episode_start[t] = self._start
            logits, self._state = infer(rollout, t, self._image, self._state)
            all_logits.append(logits)
            if self._greedy:
                rollout.action[t] = logits.argmax(-1)
            else:
                rollout.action[t] = sample(logits, self.generator)
            begin = time.perf_counter()
            result = self.env.step(rollout.action[t])
            self._image, reward, terminated, truncated, infos = result
            self.environment_s += time.perf_counter() - begin
            rollout.reward[t] = reward
            rollout.terminated[t] = terminated
            rollout.truncated[t] = truncated
            # Where an episode ends the image is already the next one's first. What a truncated one
            # would have returned after its last image is valued now, with the state of this step.
            if self._final_values:
                self._add_final_values(rollout, t, truncated & ~terminated, infos)
            self._start = terminated | truncated
            if recorder is not None:
                recorder.after_step(t, infos)
            success = infos.get("final_info", {}).get("is_success", terminated)
            self.statistics.add(reward, self._start, success)
            if until_episode_end:
                ended |= self._start
                if ended.all():
                    break
        count = len(all_logits)
        # One call for all steps: few large operations are faster than many small ones.
        rollout.log_probability[:count] = log_probability(
            torch.stack(all_logits), rollout.action[:count]
        )
        if self._final_values and not self._start.all():
            _, value, _ = self.policy.step(
                self._image, self.env.knowledge, self._state, self._start
            )
            rollout.last_value.copy_(value)
        return count

    def restart(self, seed: int | None = None) -> Tensor:
        """Start new episodes in all environments; return their images.

        Args:
            seed: of new streams of episodes; None continues the present ones.
        """
        self._image, _ = self.env.reset(seed=seed)
        self._start = torch.ones_like(self._start)
        self.statistics = EpisodeStatistics(self.env.num_envs, self.env.device)
        return self._image

    def _add_final_values(
        self,
        rollout: Rollout,
        t: int,
        cut: Tensor,
        infos: Infos,
    ) -> None:
        """Value the final observations of step t where ``cut`` (B,): truncated, not terminated."""
        ids = cut.nonzero().squeeze(1)
        if len(ids):
            h, c = self._state
            _, value, _ = self.policy.step(
                infos["final_obs"][ids],
                rollout.knowledge[t, ids],
                (h[ids], c[ids]),
                torch.zeros_like(cut[ids]),
            )
            rollout.final_value[t, ids] = value

    def get_state(self) -> Arrays:
        """Return all that `set_state` needs to continue identically, environments included."""
        tensors = {
            "observation": self._image,
            "episode_start": self._start,
            "h": self._state[0],
            "c": self._state[1],
            "generator": self.generator.get_state(),
        }
        state = to_arrays(tensors)
        state |= prefixed("episode/", self.statistics.get_state())
        return state | prefixed("env/", self.env.get_state())

    def set_state(self, state: Arrays) -> None:
        """Continue from the result of `get_state`."""

        def tensor(name: str) -> Tensor:
            return torch.tensor(state[name], device=self.env.device)

        self._image = tensor("observation")
        self._start = tensor("episode_start")
        self._state = (tensor("h"), tensor("c"))
        self.statistics.set_state(select(state, "episode/"))
        self.generator.set_state(torch.tensor(state["generator"]))
        self.env.set_state(select(state, "env/"))
