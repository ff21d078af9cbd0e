"""An agent and a world go in; played episodes, their numbers and their files come out."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.experiment.evaluation_files import EPISODE_COLUMNS, step_columns, write_table
from knowarm.experiment.evaluation_summary import summarize
from knowarm.experiment.film import write_film
from knowarm.experiment.run_folder import write_json
from knowarm.world.agents import AgentProtocol
from knowarm.world.config import EnvConfig
from knowarm.world.episodes import Episodes, evaluation_episodes
from knowarm.world.play import EpisodeResults, play
from knowarm.world.vector_env import ReachVectorEnv

FORMAT = 1
"""Version of the evaluation folder's layout."""


@dataclass(frozen=True, kw_only=True)
class EvaluationConfig:
    """How a trained agent is judged (paper section 4.2.4).

    Raises:
        UserError: a number outside its range, or episodes that the seeds do not divide.
    """

    episodes: int = 1000
    """Episodes played, in all."""

    seed: int = 1_000_003
    """Seed of the fixed episodes; far from training seeds, so that none was trained on."""

    seeds: int = 1
    """Episodes come from this many seeds, ``seed``, ``seed`` + 1, ..., in equal shares; the
    paper's analysis of variance takes 30 seeds of 100 episodes."""

    distance_m: float = 0.10
    """Largest distance of a success [m]."""

    angle_deg: float = 17.0
    """Largest angle of a success [deg]; the paper's section 4. Its section 3 says 20."""

    wide_angle_deg: float = 20.0
    """Largest angle of ``success_wide`` [deg], reported beside."""

    actions: Literal["greedy", "sampled"] = "greedy"
    """Whether the agent takes its most probable action or draws one."""

    held_out: bool = False
    """Play the colours and places that the run's environment held out of its training."""

    label: str | None = None
    """Name of the folder the evaluation is kept in; None takes ``post-training-<actions>``, with
    ``-held-out`` behind it where that is played."""

    record_steps: bool = True
    """Whether joint angles, actions, distances and angles of every step are kept."""

    record_films: int = 6
    """Episodes, from the first, whose images are kept."""

    num_envs: int = 128
    """Episodes played at once. Part of the result: sums of other batches round differently."""

    def __post_init__(self) -> None:
        for name in ("episodes", "seeds", "num_envs"):
            if getattr(self, name) < 1:
                raise UserError(f"{name} must be at least 1, got {getattr(self, name)}.")
        for name in ("distance_m", "angle_deg", "wide_angle_deg"):
            if not getattr(self, name) > 0:
                raise UserError(f"{name} must be above 0, got {getattr(self, name)}.")
        if self.wide_angle_deg < self.angle_deg:
            raise UserError(
                f"wide_angle_deg ({self.wide_angle_deg}) must not be below angle_deg "
                f"({self.angle_deg}); give a larger wide_angle_deg as well."
            )
        if self.episodes % self.seeds:
            raise UserError(
                f"{self.episodes} episodes cannot be shared equally by {self.seeds} seeds; give a "
                f"multiple of {self.seeds}."
            )

    @property
    def folder(self) -> str:
        """Name of the folder the evaluation is kept in."""
        return self.label or (
            f"post-training-{self.actions}" + ("-held-out" if self.held_out else "")
        )


@dataclass(frozen=True)
class Evaluation:
    """Everything one evaluation found.

    Attributes:
        summary: the numbers of `summarize` beside the settings they were found with.
        episodes: columns of ``episodes.parquet``.
        steps: columns of ``steps.parquet``; None when steps were not kept.
        films: one (T, H, W, 3) uint8 array for each filmed episode, the images the agent saw.
    """

    summary: dict[str, Any]
    episodes: dict[str, np.ndarray]
    steps: dict[str, np.ndarray] | None = None
    films: Sequence[np.ndarray] = field(default=())

    def write(self, folder: Path) -> None:
        """Write ``summary.json``, ``episodes.parquet``, ``steps.parquet`` and ``films/``.

        The summary comes last: a folder that has one is whole.

        Raises:
            UserError: the folder cannot be written to.
        """
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "summary.json").unlink(missing_ok=True)
        except OSError as error:
            raise UserError(f"Cannot write to {folder}: {error.strerror}.") from error
        write_table(folder / "episodes.parquet", self.episodes, EPISODE_COLUMNS)
        if self.steps is not None:
            joints = sum(name.startswith("joint_") for name in self.steps)
            write_table(folder / "steps.parquet", self.steps, step_columns(joints))
        for number, frames in enumerate(self.films):
            write_film(folder / "films" / f"{number}.webp", frames)
        write_json(folder / "summary.json", self.summary)


def evaluate(
    agent: AgentProtocol,
    env_config: EnvConfig,
    config: EvaluationConfig,
    *,
    agent_name: str = "agent",
) -> Evaluation:
    """Play the fixed episodes and describe what happened.

    Agents evaluated with the same two configs play the same episodes, so that their rows pair.

    Args:
        agent: whoever chooses the actions.
        env_config: the task; its success thresholds are replaced by those of ``config``.
        config: what to play and how to judge.
        agent_name: goes into the summary.

    Raises:
        UserError: held-out episodes were asked for, and the environment holds none out.
    """
    held_out = env_config.held_out
    if config.held_out:
        if held_out is None:
            raise UserError(
                "held_out asks for episodes that training never showed, and this environment "
                "holds none out. Train with env.held_out, or leave held_out away."
            )
        held_out = dataclasses.replace(held_out, play="held_out")
    judged = dataclasses.replace(
        env_config,
        success_distance_m=config.distance_m,
        success_angle_deg=config.angle_deg,
        held_out=held_out,
    )
    env = ReachVectorEnv(judged, min(config.num_envs, config.episodes))
    try:
        result = play(
            agent,
            env,
            _episodes(env, config),
            record_steps=True,
            record_images=config.record_films,
        )
        episodes = _episode_columns(result, env, config)
        steps = _step_columns(result) if config.record_steps else None
    finally:
        env.close()
    summary = {
        "format": FORMAT,
        "agent": agent_name,
        "label": config.folder,
        "config": to_dict(config),
        "env": to_dict(judged),
        **summarize(episodes),
    }
    return Evaluation(summary, episodes, steps, result.images)


def _episodes(env: ReachVectorEnv, config: EvaluationConfig) -> Episodes:
    """The fixed list: equal shares of each evaluation seed, one after the other."""
    share = config.episodes // config.seeds
    lists = [
        evaluation_episodes(env.scene, env.config, share, config.seed + i)
        for i in range(config.seeds)
    ]
    names = [field.name for field in dataclasses.fields(Episodes)]
    return Episodes(*(np.concatenate([getattr(each, name) for each in lists]) for name in names))


def _episode_columns(
    result: EpisodeResults, env: ReachVectorEnv, config: EvaluationConfig
) -> dict[str, np.ndarray]:
    count = len(result.length)
    names = np.array(["/".join(facet) for facet in env.facets])
    targets = np.array([target for target, _ in env.facets])
    seeds = config.seed + np.arange(config.seeds)
    return {
        "episode": np.arange(count),
        "evaluation_seed": np.repeat(seeds, count // config.seeds),
        "target": targets[result.facet],
        "facet": names[result.facet],
        "return": result.episode_return,
        "length": result.length,
        "distance_m": result.distance,
        "angle_deg": result.angle,
        "success": result.success,
        "accurate": result.distance <= config.distance_m,
        "success_wide": _ever_within(result, config),
    }


def _ever_within(result: EpisodeResults, config: EvaluationConfig) -> np.ndarray:
    """(N,) bool: success by the wider angle.

    Exact although the episodes were played by the narrower one: until an episode meets the wider
    threshold both rules play it alike.
    """
    assert result.steps is not None
    steps = result.steps
    near = (steps.distance <= config.distance_m) & (steps.angle <= config.wide_angle_deg)
    within = result.success.copy()
    within[steps.episode[near]] = True
    return within


def _step_columns(result: EpisodeResults) -> dict[str, np.ndarray]:
    assert result.steps is not None
    steps = result.steps
    columns = {
        "episode": steps.episode,
        "step": steps.step,
        "distance_m": steps.distance,
        "angle_deg": steps.angle,
        "reward": steps.reward,
    }
    for i in range(steps.joint_positions.shape[1]):
        columns[f"joint_{i + 1}_rad"] = steps.joint_positions[:, i]
        columns[f"action_{i + 1}"] = steps.actions[:, i]
    return columns
