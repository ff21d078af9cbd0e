"""An agent and a list of episodes go in; how each episode went comes out."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from knowarm.world.env import ReachVectorEnv
from knowarm.world.episodes import Episodes


class Agent(Protocol):
    """Whoever chooses the actions: scripted, or a policy."""

    def start(self, env: ReachVectorEnv) -> None:
        """Forget the past: the episodes of ``env`` were just reset."""

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Choose actions (n, J) in 0..6 from images (n, H, W, 3)."""


@dataclass(frozen=True, kw_only=True)
class StepTable:
    """One row a played step, ordered by episode and step; M rows, values after the step."""

    episode: NDArray[np.int64]
    """Number of the episode in the list, (M,)."""

    step: NDArray[np.int64]
    """Step within the episode, from 1, (M,)."""

    joint_positions: NDArray[np.float64]
    """Joint angles [rad], (M, J)."""

    actions: NDArray[np.int64]
    """Chosen actions, indices into ``ACTION_LEVELS``, (M, J)."""

    distance: NDArray[np.float64]
    """Gripper to grasp point [m], (M,)."""

    angle: NDArray[np.float64]
    """Angle between gripper and grasp frame [deg], (M,)."""

    reward: NDArray[np.float64]
    """Reward of the step, (M,)."""


@dataclass(frozen=True, kw_only=True)
class PlayResult:
    """How N episodes went; every array is (N,)."""

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
    """Every step, when asked for."""

    images: tuple[NDArray[np.uint8], ...] = ()
    """What the agent saw in the first episodes, before each step and at the end: (T + 1, H, W, 3)
    each."""


def play(
    agent: Agent,
    env: ReachVectorEnv,
    episodes: Episodes,
    *,
    record_steps: bool = False,
    record_images: int = 0,
) -> PlayResult:
    """Play episodes to their end, ``env.num_envs`` at a time, whatever the env's autoreset mode.

    Args:
        agent: whoever chooses the actions.
        env: the environment; its running episodes are left behind.
        episodes: what to play, N.
        record_steps: keep every step's joints, actions and metrics.
        record_images: keep the images of so many episodes, from the first.
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
    return PlayResult(**columns, steps=steps, images=images)


def _play_chunk(
    agent: Agent,
    env: ReachVectorEnv,
    episodes: Episodes,
    first: int,
    record_steps: bool,
    record_images: int,
) -> tuple[dict[str, NDArray], dict[str, NDArray], list[NDArray[np.uint8]]]:
    """Play the episodes from ``first`` on that fit into the environments."""
    n = env.num_envs
    count = min(n, len(episodes) - first)
    # Environments without an episode of their own repeat the last one; nobody looks at them.
    rows = np.minimum(first + np.arange(n), first + count - 1)
    observations, infos = env.reset(options={"episodes": episodes[rows]})
    agent.start(env)

    filmed = min(count, max(0, record_images - first))
    films = [[image] for image in observations[:filmed].copy()]
    active = np.arange(n) < count
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
    records: list[dict[str, NDArray]] = []
    step = 0
    while active.any():
        step += 1
        actions = agent.act(observations)
        observations, rewards, terminated, truncated, infos = env.advance(actions, active)
        result["episode_return"][active] += rewards[active]
        result["length"][active] = step
        result["success"][active] = terminated[active]
        for name in ("distance", "angle"):
            result[name][active] = infos[name][active]
        ids = np.flatnonzero(active)
        if record_steps:
            records.append(
                {
                    "episode": first + ids,
                    "step": np.full(len(ids), step, dtype=np.int64),
                    "joint_positions": env.joint_positions[ids],
                    "actions": np.asarray(actions)[ids],
                    "distance": infos["distance"][ids],
                    "angle": infos["angle"][ids],
                    "reward": rewards[ids],
                }
            )
        for i in ids[ids < filmed]:
            films[i].append(observations[i])
        active = active & ~(terminated | truncated)
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
