"""Stepping loop: plays agents on lists of episodes, for evaluation, recording and viewing."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.agents.protocol import AgentProtocol, Batch
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.sampling import Episodes

REPORT_S = 5.0
"""Least time between two lines on the progress [s]."""


@dataclass(frozen=True, kw_only=True)
class PlayedStep:
    """State of n environments after a step; after the reset for step 0."""

    step: int  # Number of the step, from 1; 0 after the reset
    played: NDArray[np.bool_]  # Environments whose episode was running before the step, (n,)
    running: NDArray[np.bool_]  # Environments whose episode is still running, (n,)
    images: NDArray[np.uint8]  # Observations, (n, H, W, 3); black where ``played`` is False
    actions: NDArray[np.int64] | None  # Actions of the step, (n, J); None for step 0
    reward: NDArray[np.float64]  # Reward of the step, (n,)
    terminated: NDArray[np.bool_]  # Whether the task is solved or has failed, (n,)
    infos: dict[str, Any]  # Infos of the environment


@dataclass(frozen=True, kw_only=True)
class StepTable:
    """One row per played step, ordered by episode and step; M rows, values after the step."""

    episode: NDArray[np.int64]  # Number of the episode in the list, (M,)
    step: NDArray[np.int64]  # Step within the episode, from 1, (M,)
    joint_positions: NDArray[np.float64]  # Joint angles, (M, J) [rad]
    actions: NDArray[np.int64]  # Chosen actions, indices into ``ACTION_LEVELS``, (M, J)
    distance: NDArray[np.float64]  # Gripper to grasp point, (M,) [m]
    angle: NDArray[np.float64]  # Angle between gripper and grasp frame, (M,) [deg]
    reward: NDArray[np.float64]  # Reward of the step, (M,)


@dataclass(frozen=True, kw_only=True)
class EpisodeResults:
    """Results of N episodes; arrays are (N,)."""

    episode_return: NDArray[np.float64]  # Sum of the rewards
    length: NDArray[np.int64]  # Steps until the episode ended
    # Infos of the environment at the end of each episode, (N, ...) each
    infos: dict[str, NDArray[Any]]
    steps: StepTable  # Every step
    # Observations of the first episodes, before each step and at the end: (T + 1, H, W, 3) each
    images: tuple[NDArray[np.uint8], ...] = ()
    # What the agent reports of each episode in ``notes``, if it has any, (N, ...) each
    notes: dict[str, NDArray[Any]] = field(default_factory=dict)

    @property
    def distance(self) -> NDArray[np.float64]:
        """Gripper to goal at the end [m], (N,)."""
        return self.infos["distance"]

    @property
    def angle(self) -> NDArray[np.float64]:
        """Angle between gripper and goal frame at the end [deg], (N,)."""
        return self.infos["angle"]

    @property
    def success(self) -> NDArray[np.bool_]:
        """Whether the task was solved, (N,)."""
        return self.infos["is_success"]


def play_steps(agent: AgentProtocol, env: ArmVectorEnv, episodes: Episodes) -> Iterator[PlayedStep]:
    """Play 1 to n episodes to their end, one per environment, and yield after every step.

    The autoreset mode of the environment does not matter. Environments without an episode of
    their own repeat the last one and are never marked as played.

    Raises:
        UserError: the environment observes more than the image.
    """
    if not isinstance(env.single_observation_space, spaces.Box):
        raise UserError("Agents play environments that observe the image; leave out observe.")
    n, count = env.num_envs, len(episodes)
    rows = np.minimum(np.arange(n), count - 1)
    images, infos = env.reset(options={"episodes": episodes[rows]})
    agent.reset(Batch.of(env))
    played = running = np.arange(n) < count
    step, actions = 0, None
    reward, terminated = np.zeros(n), np.zeros(n, dtype=np.bool_)
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
        step, played = step + 1, running
        targets = env.joint_targets.astype(np.float32)
        actions = np.asarray(agent.act({"image": images, "joint_targets": targets}))
        images, reward, terminated, truncated, infos = env.advance(actions, played)
        running = played & ~(terminated | truncated)


def play(
    agent: AgentProtocol,
    env: ArmVectorEnv,
    episodes: Episodes,
    *,
    record_images: int = 0,
    report: Callable[[str], None] = lambda line: None,
) -> EpisodeResults:
    """Play a list of episodes to their end, ``env.num_envs`` at a time.

    Args:
        agent: chooses the actions.
        env: the environment; its current episodes are abandoned.
        episodes: what to play, N.
        record_images: number of episodes, from the first, whose images are kept.
        report: receives a line on the progress every few seconds.
    """
    said = time.monotonic()
    count, n = len(episodes), env.num_envs
    images: list[list[NDArray[np.uint8]]] = [[] for _ in range(min(count, record_images))]
    ends: dict[str, NDArray[Any]] = {}
    rows: list[dict[str, NDArray]] = []
    notes: dict[str, list[NDArray[Any]]] = {}
    for first in range(0, count, n):
        if time.monotonic() - said >= REPORT_S:
            solved, said = ends["is_success"][:first].mean(), time.monotonic()
            report(f"{first:,} of {count:,} episodes, {100 * solved:.0f} % solved.")
        chunk = episodes[first : first + n]
        for moment in play_steps(agent, env, chunk):
            ids, infos = np.flatnonzero(moment.played), moment.infos
            for i in ids[first + ids < len(images)]:
                images[first + i].append(moment.images[i].copy())
            if moment.actions is None:
                continue
            ended = np.flatnonzero(moment.played & ~moment.running)
            for name, values in infos.items():
                if not name.startswith("_"):
                    kept = ends.setdefault(name, np.zeros((count, *values.shape[1:]), values.dtype))
                    kept[first + ended] = values[ended]
            rows.append(
                {
                    "episode": first + ids,
                    "step": np.full(len(ids), moment.step, dtype=np.int64),
                    "joint_positions": env.joint_positions[ids],
                    "actions": moment.actions[ids],
                    "distance": infos["distance"][ids],
                    "angle": infos["angle"][ids],
                    "reward": moment.reward[ids],
                }
            )
        for name, values in getattr(agent, "notes", {}).items():
            notes.setdefault(name, []).append(values[: len(chunk)])
    columns = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
    order = np.lexsort((columns["step"], columns["episode"]))
    columns = {name: column[order] for name, column in columns.items()}
    steps = StepTable(**columns)
    length = np.bincount(steps.episode, minlength=count)
    return EpisodeResults(
        episode_return=np.bincount(steps.episode, steps.reward, count).astype(np.float64),
        length=length,
        infos=ends,
        steps=steps,
        images=tuple(np.stack(frames) for frames in images),
        notes={name: np.concatenate(values) for name, values in notes.items()},
    )
