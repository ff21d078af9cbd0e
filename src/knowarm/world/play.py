"""Stepping loop: plays agents on lists of episodes, for evaluation, recording and viewing."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knowarm.world.agents.scripted import AgentProtocol
from knowarm.world.episodes import Episodes
from knowarm.world.vector_env import ReachVectorEnv


@dataclass(frozen=True, kw_only=True)
class PlayedStep:
    """State of n environments after a step; after the reset for step 0."""

    step: int
    """Number of the step, from 1; 0 after the reset."""

    played: NDArray[np.bool_]
    """Environments whose episode was running before the step, (n,)."""

    running: NDArray[np.bool_]
    """Environments whose episode is still running, (n,)."""

    images: NDArray[np.uint8]
    """Observations, (n, H, W, 3); black where ``played`` is False."""

    actions: NDArray[np.int64] | None
    """Actions of the step, (n, J); None for step 0."""

    reward: NDArray[np.float64]
    """Reward of the step, (n,)."""

    terminated: NDArray[np.bool_]
    """Whether the target is reached, or with several objects another one, (n,)."""

    infos: dict[str, Any]
    """Infos of the environment."""


@dataclass(frozen=True, kw_only=True)
class StepTable:
    """One row per played step, ordered by episode and step; M rows, values after the step."""

    episode: NDArray[np.int64]
    """Number of the episode in the list, (M,)."""

    step: NDArray[np.int64]
    """Step within the episode, from 1, (M,)."""

    joint_positions: NDArray[np.float64]
    """Joint angles, (M, J) [rad]."""

    actions: NDArray[np.int64]
    """Chosen actions, indices into ``ACTION_LEVELS``, (M, J)."""

    distance: NDArray[np.float64]
    """Gripper to grasp point, (M,) [m]."""

    angle: NDArray[np.float64]
    """Angle between gripper and grasp frame, (M,) [deg]."""

    reward: NDArray[np.float64]
    """Reward of the step, (M,)."""


@dataclass(frozen=True, kw_only=True)
class EpisodeResults:
    """Results of N episodes; every array is (N,)."""

    episode_return: NDArray[np.float64]
    """Sum of the rewards."""

    length: NDArray[np.int64]
    """Steps until the episode ended."""

    distance: NDArray[np.float64]
    """Gripper to grasp point at the end [m]."""

    angle: NDArray[np.float64]
    """Angle between gripper and grasp frame at the end [deg]."""

    success: NDArray[np.bool_]
    """Whether both thresholds were met."""

    target: NDArray[np.int64]
    """Index of the target."""

    colour: NDArray[np.int64]
    """Index of its colour."""

    facet: NDArray[np.int64]
    """Index into the environment's facets."""

    query: NDArray[np.int64]
    """Number of the query, 0 in reaching."""

    chosen: NDArray[np.int64]
    """Index of the target nearest to the gripper at the end: in reaching the only one."""

    steps: StepTable
    """Every step."""

    images: tuple[NDArray[np.uint8], ...] = ()
    """Observations of the first episodes, before each step and at the end: (T + 1, H, W, 3)
    each."""


def play_steps(
    agent: AgentProtocol, env: ReachVectorEnv, episodes: Episodes
) -> Iterator[PlayedStep]:
    """Play at most n episodes to their end, one per environment, and yield after every step.

    The autoreset mode of the environment does not matter. Environments without an episode of
    their own repeat the last one and are never marked as played.

    Args:
        agent: chooses the actions.
        env: the environment; its current episodes are abandoned.
        episodes: what to play, 1 to n.
    """
    n, count = env.num_envs, len(episodes)
    rows = np.minimum(np.arange(n), count - 1)
    images, infos = env.reset(options={"episodes": episodes[rows]})
    agent.start(env)
    running = np.arange(n) < count
    yield PlayedStep(
        step=0,
        played=running,
        running=running,
        images=images,
        actions=None,
        reward=np.zeros(n),
        terminated=np.zeros(n, dtype=np.bool_),
        infos=infos,
    )
    step = 0
    while running.any():
        step += 1
        actions = agent.act(images)
        played = running
        images, reward, terminated, truncated, infos = env.advance(actions, played)
        running = played & ~(terminated | truncated)
        yield PlayedStep(
            step=step,
            played=played,
            running=running,
            images=images,
            actions=np.asarray(actions),
            reward=reward,
            terminated=terminated,
            infos=infos,
        )


def play(
    agent: AgentProtocol,
    env: ReachVectorEnv,
    episodes: Episodes,
    *,
    record_images: int = 0,
) -> EpisodeResults:
    """Play a list of episodes to their end, ``env.num_envs`` at a time.

    Args:
        agent: chooses the actions.
        env: the environment; its current episodes are abandoned.
        episodes: what to play, N.
        record_images: number of episodes, from the first, whose images are kept.
    """
    count, n = len(episodes), env.num_envs
    images: list[list[NDArray[np.uint8]]] = [[] for _ in range(min(count, record_images))]
    facets: list[NDArray[np.int64]] = []
    rows: list[dict[str, NDArray]] = []
    for first in range(0, count, n):
        chunk = episodes[first : first + n]
        for moment in play_steps(agent, env, chunk):
            ids, infos = np.flatnonzero(moment.played), moment.infos
            for i in ids[first + ids < len(images)]:
                images[first + i].append(moment.images[i].copy())
            if moment.actions is None:
                facets.append(infos["facet"][: len(chunk)])
                continue
            rows.append(
                {
                    "episode": first + ids,
                    "step": np.full(len(ids), moment.step, dtype=np.int64),
                    "joint_positions": env.joint_positions[ids],
                    "actions": moment.actions[ids],
                    "distance": infos["distance"][ids],
                    "angle": infos["angle"][ids],
                    "reward": moment.reward[ids],
                    "success": infos["is_success"][ids],
                    "chosen": infos.get("chosen", infos["target"])[ids],
                }
            )
    columns = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
    order = np.lexsort((columns["step"], columns["episode"]))
    columns = {name: column[order] for name, column in columns.items()}
    success, chosen = columns.pop("success"), columns.pop("chosen")
    steps = StepTable(**columns)
    length = np.bincount(steps.episode, minlength=count)
    last = np.cumsum(length) - 1
    return EpisodeResults(
        episode_return=np.bincount(steps.episode, steps.reward, count).astype(np.float64),
        length=length,
        distance=steps.distance[last],
        angle=steps.angle[last],
        success=success[last],
        target=episodes.target,
        colour=episodes.colour,
        facet=np.concatenate(facets),
        query=episodes.query,
        chosen=chosen[last],
        steps=steps,
        images=tuple(np.stack(frames) for frames in images),
    )
