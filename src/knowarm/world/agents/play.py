"""Stepping loop: plays agents on lists of episodes, for evaluation, recording and viewing."""

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from gymnasium import spaces

from knowarm.arrays import Array, Floats, Images, Integers, Mask
from knowarm.errors import UserError
from knowarm.world.agents.protocol import AgentProtocol, Batch
from knowarm.world.envs.single_env import ArmEnv, vector_of
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.sampling import Episodes
from knowarm.world.tasks.state import NamedArrays

REPORT_S = 5.0
"""Least time between two lines on the progress [s]."""


@dataclass(frozen=True, kw_only=True)
class PlayedStep:
    """State of n environments after a step; after the reset for step 0."""

    step: int  # Number of the step, from 1; 0 after the reset
    played: Mask  # Environments whose episode was running before the step, (n,)
    running: Mask  # Environments whose episode is still running, (n,)
    images: Images  # Observations, (n, H, W, 3); black where ``played`` is False
    actions: Integers | None  # Actions of the step, (n, J); None for step 0
    reward: Floats  # Reward of the step, (n,)
    terminated: Mask  # Whether the task is solved or has failed, (n,)
    infos: dict[str, Any]  # Infos of the environment


@dataclass(frozen=True, kw_only=True)
class StepTable:
    """One row per played step, ordered by episode and step; M rows, values after the step."""

    episode: Integers  # Number of the episode in the list, (M,)
    step: Integers  # Step within the episode, from 1, (M,)
    joint_positions: Floats  # Joint angles, (M, J) [rad]
    actions: Integers  # Chosen actions, indices into ``ACTION_LEVELS``, (M, J)
    distance: Floats  # Gripper to grasp point, (M,) [m]
    angle: Floats  # Angle between gripper and grasp frame, (M,) [deg]
    reward: Floats  # Reward of the step, (M,)


@dataclass(frozen=True, kw_only=True)
class EpisodeResults:
    """Results of N episodes; arrays are (N,)."""

    episode_return: Floats  # Sum of the rewards
    length: Integers  # Steps until the episode ended
    # Infos of the environment at the end of each episode, (N, ...) each
    infos: NamedArrays
    steps: StepTable  # Every step
    # Observations of the first episodes, before each step and at the end: (T + 1, H, W, 3) each
    images: tuple[Images, ...] = ()
    # What the agent reports of each episode in ``notes``, if it has any, (N, ...) each
    notes: NamedArrays = field(default_factory=dict)

    @property
    def distance(self) -> Floats:
        """Gripper to goal at the end [m], (N,)."""
        return self.infos["distance"]

    @property
    def angle(self) -> Floats:
        """Angle between gripper and goal frame at the end [deg], (N,)."""
        return self.infos["angle"]

    @property
    def success(self) -> Mask:
        """Whether the task was solved, (N,)."""
        return self.infos["is_success"]


def play_steps(
    agent: AgentProtocol,
    env: ArmVectorEnv,
    episodes: Episodes,
) -> Iterator[PlayedStep]:
    """Play 1 to n episodes to their end, one per environment, and yield after every step.

    The autoreset mode of the environment does not matter. Environments without an episode of
    their own repeat the last one and are never marked as played.

    Raises:
        UserError: the environment observes more than the image.
    """
    if not isinstance(env.single_observation_space, spaces.Box):
        raise UserError(
            "Agents play environments that observe the image; leave out observe."
        )
    n = env.num_envs
    count = len(episodes)
    rows = np.minimum(np.arange(n), count - 1)
    images, infos = env.reset(options={"episodes": episodes[rows]})
    agent.reset(Batch.of(env))
    running = np.arange(n) < count
    played = running
    step = 0
    actions = None
    reward = np.zeros(n)
    terminated = np.zeros(n, bool)
    while True:
        yield PlayedStep(
            step=step,
            played=played,
            running=running,
            images=images,
            actions=actions,
            reward=reward,
            terminated=terminated,
            infos=infos,
        )
        if not running.any():
            return
        step += 1
        played = running
        targets = env.joint_targets.astype(np.float32)
        actions = np.asarray(agent.act({"image": images, "joint_targets": targets}))
        images, reward, terminated, truncated, infos = env.advance(
            actions, played, played
        )
        running = played & ~(terminated | truncated)


def play(
    agent: AgentProtocol,
    env: ArmEnv | ArmVectorEnv,
    episodes: Episodes,
    *,
    record_images: int = 0,
    report: Callable[[str], None] = lambda line: None,
) -> EpisodeResults:
    """Play a list of episodes to their end, ``env.num_envs`` at a time.

    Args:
        agent: chooses the actions.
        env: the environment, single ones also of `gymnasium.make`; its current episodes are
            abandoned.
        episodes: what to play, N.
        record_images: number of episodes, from the first, whose images are kept.
        report: receives a line on the progress every few seconds.

    Raises:
        UserError: the environment is of another kind, wrapped, or observes more than the image.
    """
    env = vector_of(env)
    reported = time.monotonic()
    count = len(episodes)
    n = env.num_envs
    images: list[list[Images]] = [[] for _ in range(min(count, record_images))]
    ends: NamedArrays = {}
    rows: dict[str, list[Array]] = defaultdict(list)
    notes: dict[str, list[Array]] = defaultdict(list)
    for first in range(0, count, n):
        if time.monotonic() - reported >= REPORT_S:
            solved = ends["is_success"][:first].mean()
            reported = time.monotonic()
            report(f"{first:,} of {count:,} episodes, {100 * solved:.0f} % solved.")
        chunk = episodes[first : first + n]
        for moment in play_steps(agent, env, chunk):
            infos = moment.infos
            ids = np.flatnonzero(moment.played)
            for i in ids[first + ids < len(images)]:
                images[first + i].append(moment.images[i].copy())
            if moment.actions is None:
                continue
            ended = np.flatnonzero(moment.played & ~moment.running)
            for name, values in infos.items():
                if name.startswith("_"):
                    continue
                if name not in ends:
                    ends[name] = np.zeros((count, *values.shape[1:]), values.dtype)
                ends[name][first + ended] = values[ended]
            recorded = {
                "episode": first + ids,
                "step": np.full(len(ids), moment.step, np.int64),
                "joint_positions": env.joint_positions[ids],
                "actions": moment.actions[ids],
                "distance": infos["distance"][ids],
                "angle": infos["angle"][ids],
                "reward": moment.reward[ids],
            }
            for name, values in recorded.items():
                rows[name].append(values)
        for name, values in getattr(agent, "notes", {}).items():
            notes[name].append(values[: len(chunk)])
    columns = _concatenated(rows)
    order = np.lexsort((columns["step"], columns["episode"]))
    steps = StepTable(**{name: column[order] for name, column in columns.items()})
    returns = np.bincount(steps.episode, steps.reward, count)
    return EpisodeResults(
        episode_return=returns.astype(np.float64),
        length=np.bincount(steps.episode, minlength=count),
        infos=ends,
        steps=steps,
        images=tuple(np.stack(frames) for frames in images),
        notes=_concatenated(notes),
    )


def _concatenated(columns: dict[str, list[Array]]) -> NamedArrays:
    return {name: np.concatenate(pieces) for name, pieces in columns.items()}
