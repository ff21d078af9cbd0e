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
    """Whether the target is reached, (n,)."""

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
    """Steps until success or the time limit."""

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

    steps: StepTable | None = None
    """Every step, if recorded."""

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
    record_steps: bool = False,
    record_images: int = 0,
) -> EpisodeResults:
    """Play a list of episodes to their end, ``env.num_envs`` at a time.

    Args:
        agent: chooses the actions.
        env: the environment; its current episodes are abandoned.
        episodes: what to play, N.
        record_steps: keep joints, actions and metrics of every step.
        record_images: number of episodes, from the first, whose images are kept.
    """
    chunks = [
        _play_chunk(agent, env, episodes, first, record_steps, record_images)
        for first in range(0, len(episodes), env.num_envs)
    ]
    columns = {name: np.concatenate([chunk[0][name] for chunk in chunks]) for name in chunks[0][0]}
    images = tuple(image for chunk in chunks for image in chunk[2])
    steps = None
    if record_steps:
        rows = {name: np.concatenate([chunk[1][name] for chunk in chunks]) for name in chunks[0][1]}
        order = np.lexsort((rows["step"], rows["episode"]))
        steps = StepTable(**{name: column[order] for name, column in rows.items()})
    return EpisodeResults(**columns, steps=steps, images=images)


def _play_chunk(
    agent: AgentProtocol,
    env: ReachVectorEnv,
    episodes: Episodes,
    first: int,
    record_steps: bool,
    record_images: int,
) -> tuple[dict[str, NDArray], dict[str, NDArray], list[NDArray[np.uint8]]]:
    """Play the episodes from ``first`` that fit into the environments.

    Returns:
        Columns of ``EpisodeResults``, columns of ``StepTable``, and the recorded images.
    """
    n = env.num_envs
    count = min(n, len(episodes) - first)
    recorded = min(count, max(0, record_images - first))
    films: list[list[NDArray[np.uint8]]] = [[] for _ in range(recorded)]
    result: dict[str, NDArray] = {}
    records: list[dict[str, NDArray]] = []
    for moment in play_steps(agent, env, episodes[first : first + count]):
        played, infos = moment.played, moment.infos
        ids = np.flatnonzero(played)
        for i in ids[ids < recorded]:
            films[i].append(moment.images[i].copy())
        if moment.actions is None:
            result = {
                "episode_return": np.zeros(n),
                "length": np.zeros(n, dtype=np.int64),
                "distance": np.zeros(n),
                "angle": np.zeros(n),
                "success": np.zeros(n, dtype=np.bool_),
                "target": infos["target"],
                "colour": infos["colour"],
                "facet": infos["facet"],
            }
            continue
        result["episode_return"][played] += moment.reward[played]
        result["length"][played] = moment.step
        result["success"][played] = moment.terminated[played]
        for name in ("distance", "angle"):
            result[name][played] = infos[name][played]
        if record_steps:
            records.append(
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
    table = (
        {name: np.concatenate([record[name] for record in records]) for name in records[0]}
        if records
        else {}
    )
    return (
        {name: values[:count] for name, values in result.items()},
        table,
        [np.stack(film) for film in films],
    )
