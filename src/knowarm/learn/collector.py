"""Rollout collector: steps vector environments with a policy and fills rollouts."""

from collections.abc import Callable
from typing import cast

import numpy as np
import torch
from torch import Tensor

from knowarm.learn.curriculum import ThresholdCurriculum
from knowarm.learn.device import Stopwatch
from knowarm.learn.environment import Infos, PrivilegedVectorEnv, TorchVectorEnv
from knowarm.learn.episode_statistics import EpisodeStatistics
from knowarm.learn.privileged import PrivilegedRollout
from knowarm.learn.rollout import Rollout
from knowarm.policy import Policy, State
from knowarm.policy.actions import log_probability, sample
from knowarm.seeding import derive_seed, torch_generator

Infer = Callable[[Rollout, int, Tensor, State], tuple[Tensor, State]]
"""Inference of one step; arguments and results as `infer_step`."""


@torch.no_grad()
def infer_step(
    policy: Policy,
    rollout: Rollout,
    t: int,
    image: Tensor,
    state: State,
    envs: slice = slice(None),
) -> tuple[Tensor, State]:
    """Run the policy for step t of some environments.

    Args:
        policy: the policy.
        rollout: ``facet`` and ``episode_start`` of step t are read; ``patches`` and ``value`` of
            step t are written.
        t: the step.
        image: (B, H, W, 3) uint8 of all environments.
        state: recurrent state of all environments after the previous step.
        envs: the b environments to compute.

    Returns:
        Logits (b, J, A) and the next state of these environments, (b, H) each.
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


class Collector:
    """Steps the environments with the policy; episodes continue from one rollout to the next.

    Args:
        env: the vector environment; it is reset with a seed derived from ``seed``.
        policy: on the environment's device.
        seed: of the run; episodes and sampled actions have a stream each.
        stream: tells several collectors of a run apart (A3C: worker, number of its restarts).
        final_values: computes the values of final observations; by default at once on the CPU
            and later on a GPU.
        curriculum: of the environment's success thresholds.

    Raises:
        UserError: the policy's knowledge table has no row for a facet of the environment.
    """

    def __init__(
        self,
        env: TorchVectorEnv,
        policy: Policy,
        *,
        seed: int,
        stream: tuple[int, ...] = (),
        final_values: "ImmediateFinalValues | DeferredFinalValues | NoFinalValues | None" = None,
        curriculum: ThresholdCurriculum | None = None,
    ) -> None:
        self.env = env
        self.policy = policy
        self.curriculum = curriculum
        self.statistics = EpisodeStatistics(env.num_envs, env.device)
        self.generator = torch_generator(seed, "actions", *stream, device=env.device)
        self._stopwatch = Stopwatch(env.device)
        self._image, _ = env.reset(seed=derive_seed(seed, "episodes", *stream))
        self._start = torch.ones(env.num_envs, dtype=torch.bool, device=env.device)
        self._state: State = policy.initial_state(env.num_envs)
        if final_values is None:
            on_cpu = env.device.type == "cpu"
            final_values = (
                ImmediateFinalValues(policy) if on_cpu else DeferredFinalValues(policy, env)
            )
        self._final_values = final_values
        policy.check_facets(env.facet_ids)

    @property
    def environment_s(self) -> float:
        """Total time of the environments' steps [s]; synchronizes with a GPU."""
        return self._stopwatch.seconds()

    @torch.no_grad()
    def collect(
        self,
        rollout: Rollout,
        infer: Infer | None = None,
        *,
        until_episode_end: bool = False,
        privileged: PrivilegedRollout | None = None,
    ) -> int:
        """Fill the rollout with the next T steps of all environments.

        Args:
            rollout: overwritten.
            infer: inference of one step; by default `infer_step` with the policy.
            until_episode_end: stop after the first step in which an episode ends (CPU only).
            privileged: overwritten with the privileged states; the environment must be a
                `PrivilegedVectorEnv`.

        Returns:
            The number of steps t; only the rollout's first t rows are valid (`Rollout.first`).
        """
        steps, _ = rollout.shape
        logits: list[Tensor] = []
        rollout.start_h.copy_(self._state[0])
        rollout.start_c.copy_(self._state[1])
        rollout.final_value.zero_()
        env = cast(PrivilegedVectorEnv, self.env)
        if privileged is not None:
            privileged.state[0] = env.privileged_state
        for t in range(steps):
            rollout.facet[t] = self.env.facet_ids
            rollout.episode_start[t] = self._start
            if infer is None:
                logit, self._state = infer_step(self.policy, rollout, t, self._image, self._state)
            else:
                logit, self._state = infer(rollout, t, self._image, self._state)
            logits.append(logit)
            rollout.action[t] = sample(logit, self.generator)
            self._stopwatch.start()
            self._image, reward, terminated, truncated, infos = self.env.step(rollout.action[t])
            self._stopwatch.stop()
            rollout.reward[t] = reward
            rollout.terminated[t] = terminated
            rollout.truncated[t] = truncated
            self._final_values.add(rollout, t, truncated & ~terminated, self._state, infos)
            self._start = terminated | truncated
            if privileged is not None:
                privileged.next_state[t] = infos["final_privileged_state"]
                if t + 1 < steps:
                    privileged.state[t + 1] = env.privileged_state
            success = infos.get("final_info", {}).get("is_success", terminated)
            self.statistics.add(reward, self._start, success)
            if until_episode_end and bool(self._start.any()):
                break
        count = len(logits)
        rollout.log_probability[:count] = log_probability(
            torch.stack(logits), rollout.action[:count]
        )
        _, value, _ = self.policy.step(self._image, self.env.facet_ids, self._state, self._start)
        rollout.last_value.copy_(value)
        return count

    def get_state(self) -> dict[str, np.ndarray]:
        """Return all that `set_state` needs to continue identically, environments included."""
        tensors = {
            "observation": self._image,
            "episode_start": self._start,
            "h": self._state[0],
            "c": self._state[1],
            "generator": self.generator.get_state(),
        }
        state = {name: tensor.cpu().numpy().copy() for name, tensor in tensors.items()}
        state.update({f"episode/{k}": v for k, v in self.statistics.get_state().items()})
        if self.curriculum is not None and self.curriculum.is_used:
            state["threshold_factor"] = np.array(self.curriculum.factor)
        state.update({f"env/{k}": np.asarray(v) for k, v in self.env.get_state().items()})
        return state

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Continue from the result of `get_state`."""

        def place(name: str) -> Tensor:
            return torch.from_numpy(state[name].copy()).to(self.env.device)

        self._image, self._start = place("observation"), place("episode_start")
        self._state = (place("h"), place("c"))
        self.generator.set_state(torch.from_numpy(state["generator"].copy()))
        self.statistics.set_state(select(state, "episode/"))
        if self.curriculum is not None and self.curriculum.is_used:
            self.curriculum.factor = float(state["threshold_factor"])
        self.env.set_state(select(state, "env/"))


class ImmediateFinalValues:
    """Values final observations at once, only those of truncated episodes: for the CPU.

    Args:
        policy: computes the values.
    """

    def __init__(self, policy: Policy) -> None:
        self._policy = policy

    def add(self, rollout: Rollout, t: int, cut: Tensor, state: State, infos: Infos) -> None:
        """Value the final observations of step t.

        Args:
            rollout: ``final_value`` is written.
            t: the step.
            cut: (B,) bool, truncated and not terminated at this step.
            state: recurrent state after the step's inference.
            infos: of the step, with ``final_obs``.
        """
        ids = cut.nonzero().squeeze(1)
        if len(ids):
            image, start = infos["final_obs"][ids], torch.zeros_like(cut[ids])
            state = (state[0][ids], state[1][ids])
            _, value, _ = self._policy.step(image, rollout.facet[t, ids], state, start)
            rollout.final_value[t, ids] = value


class NoFinalValues:
    """Values no final observations: another critic values the states.

    Args:
        env: if it has the attribute ``report_final_observations``, it need not draw them.
    """

    def __init__(self, env: TorchVectorEnv) -> None:
        if hasattr(env, "report_final_observations"):
            env.report_final_observations = False

    def add(self, rollout: Rollout, t: int, cut: Tensor, state: State, infos: Infos) -> None:
        """Do nothing; see `ImmediateFinalValues.add`."""


class DeferredFinalValues:
    """Values final observations together, without synchronizing with the device: for GPUs.

    Finding out which episodes were truncated would synchronize. So the final observation of each
    environment is stored, and all of them are valued after as many steps as no environment can be
    truncated twice in.

    Args:
        policy: computes the values.
        env: gives number of environments, device and smallest time between truncations.
    """

    def __init__(self, policy: Policy, env: TorchVectorEnv) -> None:
        self._policy = policy
        self._interval = env.max_episode_steps
        count, device = env.num_envs, env.device
        self._cut = torch.zeros(count, dtype=torch.bool, device=device)
        self._time = torch.zeros(count, dtype=torch.int64, device=device)
        facet_shape, dtype = policy.facet_spec
        self._facet = torch.zeros((count, *facet_shape), dtype=dtype, device=device)
        shape = (count, *policy.encoder.patch_shape)
        self._patches = torch.zeros(shape, dtype=torch.uint8, device=device)
        self._state: State = policy.initial_state(count)

    def add(self, rollout: Rollout, t: int, cut: Tensor, state: State, infos: Infos) -> None:
        """Store the final observations; see `ImmediateFinalValues.add`."""
        if "final_obs" in infos:
            self._store(rollout, t, cut, state, infos["final_obs"])
        if (t + 1) % self._interval == 0 or t + 1 == len(rollout.reward):
            self._write_values(rollout)

    def _store(self, rollout: Rollout, t: int, cut: Tensor, state: State, image: Tensor) -> None:
        column = cut[:, None]
        patches = self._policy.patches(image)
        self._patches = torch.where(column[..., None], patches, self._patches)
        new = rollout.facet[t]
        self._facet = torch.where(cut.view(-1, *[1] * (new.ndim - 1)), new, self._facet)
        self._time = torch.where(cut, t, self._time)
        h, c = (torch.where(column, new, old) for new, old in zip(state, self._state, strict=True))
        self._state = (h, c)
        self._cut = self._cut | cut

    def _write_values(self, rollout: Rollout) -> None:
        start = torch.zeros_like(self._cut)
        _, value, _ = self._policy.step(self._patches, self._facet, self._state, start)
        place = self._time[None]
        old = rollout.final_value.gather(0, place)[0]
        rollout.final_value.scatter_(0, place, torch.where(self._cut, value, old)[None])
        self._cut = torch.zeros_like(self._cut)
        self._time = torch.zeros_like(self._time)


def select(state: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """Return the entries whose names start with ``prefix``, without the prefix."""
    return {k[len(prefix) :]: v for k, v in state.items() if k.startswith(prefix)}
