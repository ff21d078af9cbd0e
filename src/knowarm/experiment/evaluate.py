"""Evaluation of an agent on fixed episodes (paper section 4.2.4)."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from knowarm.config import replace, to_dict
from knowarm.errors import UserError
from knowarm.experiment.blind import blind_numbers
from knowarm.experiment.build import TrainedAgent, load_agent
from knowarm.experiment.config import EvaluationConfig
from knowarm.experiment.evaluation_files import (
    CHOICE_COLUMNS,
    EPISODE_COLUMNS,
    step_columns,
    write_film,
    write_table,
)
from knowarm.experiment.graph_queries import GraphQueries, old_answers, retold
from knowarm.experiment.run_folder import write_json
from knowarm.statistics import Interval, bootstrap, wilson
from knowarm.world.agents import AgentProtocol
from knowarm.world.config import EnvConfig
from knowarm.world.episodes import Episodes, evaluation_episodes
from knowarm.world.play import EpisodeResults, play
from knowarm.world.vector_env import ReachVectorEnv

FORMAT = 2
"""Version of the evaluation folder's layout."""


@dataclass(frozen=True)
class EvaluationResult:
    """Everything that one evaluation measured.

    Attributes:
        summary: the numbers of `summarize` and the settings they were measured with.
        episodes: columns of ``episodes.parquet``, one row per episode.
        steps: columns of ``steps.parquet``, one row per step; None where not recorded.
        films: one (T, H, W, 3) uint8 array for each recorded episode, the agent's observations.
        folder: where `write` stores the files: for a trained agent
            ``<run>/evaluation/<label>/``, where reports find them; None for other agents.
    """

    summary: dict[str, Any]
    episodes: dict[str, np.ndarray]
    steps: dict[str, np.ndarray] | None = None
    films: Sequence[np.ndarray] = field(default=())
    folder: Path | None = None

    def write(self, folder: Path | str | None = None) -> Path:
        """Write ``summary.json``, ``episodes.parquet``, ``steps.parquet`` and ``films/``.

        The summary is written last: a folder with a summary is complete.

        Args:
            folder: where to write; None takes ``self.folder``.

        Returns:
            The folder.

        Raises:
            UserError: there is no folder, or it cannot be written to.
        """
        if folder is None and self.folder is None:
            raise UserError("This evaluation belongs to no run: pass a folder to write it to.")
        folder = Path(folder or self.folder or ".")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "summary.json").unlink(missing_ok=True)
        except OSError as error:
            raise UserError(f"Cannot write to {folder}: {error.strerror}.") from error
        further = {name: each for name, each in CHOICE_COLUMNS.items() if name in self.episodes}
        columns = EPISODE_COLUMNS | further
        write_table(folder / "episodes.parquet", self.episodes, columns)
        if self.steps is not None:
            joints = sum(name.startswith("joint_") for name in self.steps)
            write_table(folder / "steps.parquet", self.steps, step_columns(joints))
        for number, frames in enumerate(self.films):
            write_film(folder / "films" / f"{number}.webp", frames)
        write_json(folder / "summary.json", self.summary)
        return folder


def evaluate(
    agent: AgentProtocol | TrainedAgent | Path | str,
    env_config: EnvConfig | None = None,
    config: EvaluationConfig | None = None,
    *,
    agent_name: str = "agent",
    **overrides: Any,
) -> EvaluationResult:
    """Play the fixed episodes and measure returns, accuracy and success.

    Beside a trained agent, the blind agents play the first ``config.blind_episodes`` of them: see
    `knowarm.experiment.blind.blind_numbers`.

    Agents evaluated with equal configs play the same episodes, so that their rows are paired.

    Args:
        agent: a run folder, what `load_agent` returned, or any object with ``start(env)`` and
            ``act(images)``.
        env_config: the task; its success thresholds are replaced by those of ``config``. None
            takes the task that a trained agent was trained on.
        config: episodes and thresholds; None takes the defaults.
        agent_name: name in the summary; a trained agent has the name of its run.
        **overrides: fields of ``config`` to change, such as ``episodes=200``.

    Returns:
        The result, with the columns of every episode; `EvaluationResult.write` stores it.

    Raises:
        UserError: a run folder that cannot be loaded, an agent without a task, or held-out
            episodes of an environment that holds none out.
    """
    config = replace(config or EvaluationConfig(), overrides)
    if isinstance(agent, str | Path):
        agent = load_agent(agent, greedy=config.actions == "greedy", seed=config.seed)
    folder, blind_episodes, trained = None, 0, None
    if isinstance(agent, TrainedAgent):
        blind_episodes = config.blind_episodes if agent.which != "untrained" else 0
        if agent.which != "best":
            config = dataclasses.replace(config, label=f"{config.folder}-{agent.which}")
        env_config = env_config or agent.config.env
        agent_name = f"{agent.config.name}/{agent.config.seed}"
        folder = agent.folder.evaluation(config.folder)
        trained, agent = agent, agent.agent
    if env_config is None:
        raise UserError("This agent has no task of its own: pass env_config=EnvConfig(...).")
    judged = _with_thresholds(env_config, config)
    env = ReachVectorEnv(judged, min(config.num_envs, config.episodes))
    told: torch.Tensor | None = None
    try:
        if trained is not None and config.split == "S5":
            told = trained.tell(torch.from_numpy(retold(trained.config, judged)))
        fixed = _episodes(env, config)
        result = play(agent, env, fixed, record_images=config.record_films)
        blind = blind_numbers(agent, result.success, env, fixed, blind_episodes, config.seed)
        episodes = _episode_columns(result, env, config)
        steps = _step_columns(result) if config.record_steps else None
    finally:
        env.close()
        if trained is not None and told is not None:
            trained.tell(told)
    summary = {
        "format": FORMAT,
        "agent": agent_name,
        "label": config.folder,
        "config": to_dict(config),
        "env": to_dict(judged),
        **summarize(episodes),
        **blind,
        **({"choice_chance": 1 / judged.choice.objects} if judged.choice else {}),
    }
    return EvaluationResult(summary, episodes, steps, result.images, folder)


def _with_thresholds(env_config: EnvConfig, config: EvaluationConfig) -> EnvConfig:
    """Return the task with the success thresholds and the held-out episodes of the evaluation."""
    held_out = env_config.held_out
    if config.held_out:
        if held_out is None:
            raise UserError(
                "held_out=True plays episodes that were excluded from training, and this "
                "environment holds none out. Train with env.held_out, or leave held_out out."
            )
        held_out = dataclasses.replace(held_out, play="held_out")
    choice = env_config.choice
    if config.split is not None:
        if choice is None or not isinstance(choice.queries, GraphQueries):
            raise UserError(
                f"split={config.split!r} selects what a graph's queries ask, and this task asks "
                "none. Evaluate a run of the choice task, or leave split out."
            )
        edited = config.edited or choice.queries.edited
        queries = dataclasses.replace(choice.queries, split=config.split, edited=edited)
        choice = dataclasses.replace(choice, queries=queries)
    return dataclasses.replace(
        env_config,
        success_distance_m=config.distance_m,
        success_angle_deg=config.angle_deg,
        held_out=held_out,
        choice=choice,
    )


def _episodes(env: ReachVectorEnv, config: EvaluationConfig) -> Episodes:
    """Draw the fixed episodes: equal shares of each evaluation seed, in order."""
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
    seeds = config.seed + np.arange(config.seeds)
    targets = np.array([target.name for target in env.scene.targets])
    columns = {
        "episode": np.arange(count),
        "evaluation_seed": np.repeat(seeds, count // config.seeds),
        "target": targets[result.target],
        "facet": names[result.facet],
        "return": result.episode_return,
        "length": result.length,
        "distance_m": result.distance,
        "angle_deg": result.angle,
        "success": result.success,
        "accurate": result.distance <= config.distance_m,
        "success_wide": _ever_within(result, config),
    }
    if env.queries:
        columns |= {
            "query": np.array(env.queries)[result.query],
            "chosen": targets[result.chosen],
            "choice_correct": result.chosen == result.target,
        }
    if config.split == "S5":
        before = old_answers(env.config)
        asked = zip(columns["query"], columns["chosen"], strict=True)
        columns["chose_old_answer"] = np.array([name in before.get(q, ()) for q, name in asked])
    return columns


def _ever_within(result: EpisodeResults, config: EvaluationConfig) -> np.ndarray:
    """Return (N,) bool: success with the wider angle.

    Exact although the episodes were played with the narrower one: until an episode meets the wider
    threshold, both thresholds give the same steps.
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


Columns = Mapping[str, np.ndarray]
"""One (n,) array per column, as `evaluation_files.EPISODE_COLUMNS` describes them."""


def summarize(episodes: Columns) -> dict[str, Any]:
    """Compute the numbers of the paper's post-training evaluation, with 95 % intervals.

    Args:
        episodes: the columns of `evaluation_files.EPISODE_COLUMNS`, n at least 1.

    Returns:
        Numbers of all episodes, and the same under ``per_target`` and ``per_facet``:
        ``return_*``, ``length_*`` and ``failure_distance_*`` (mean, std, max; episodes without
        success; None where there were none), ``accuracy`` (the paper's: final distance only),
        ``success`` (distance and angle at the same step) and ``success_wide`` (the wider angle),
        each of these three with Wilson's interval. ``return_mean`` and ``length_mean`` have
        bootstrap intervals over episodes. Standard deviations are those of the sample (n - 1).
        Where an episode asks a query also ``choice``, the share of episodes that ended nearest to
        the wanted object, with Wilson's interval, ``success_if_chosen``, the success among these,
        and groups ``per_query``; on split S5 also ``chose_old_answer``, the share that ended
        nearest to an object that the query meant before the graph was edited.
    """
    summary = _numbers(episodes)
    groups = {"per_target": "target", "per_facet": "facet"}
    if "query" in episodes:
        groups["per_query"] = "query"
    for group, column in groups.items():
        keys = episodes[column]
        summary[group] = {
            str(name): _numbers({key: values[keys == name] for key, values in episodes.items()})
            for name in sorted(set(keys))
        }
    return summary


def _numbers(episodes: Columns) -> dict[str, Any]:
    """The numbers of `summarize` for one group of episodes."""
    count = len(episodes["return"])
    failures = episodes["distance_m"][~episodes["success"]]
    values: dict[str, Any] = {"episodes": count}
    for name in ("return", "length"):
        values[f"{name}_mean"] = float(np.mean(episodes[name]))
        values[f"{name}_std"] = _std(episodes[name])
        values |= _bounds(f"{name}_mean", bootstrap([episodes[name]], repetitions=2_000))
    for name in ("accuracy", "success", "success_wide"):
        column = "accurate" if name == "accuracy" else name
        share = wilson(int(np.count_nonzero(episodes[column])), count)
        values |= {name: share.estimate, **_bounds(name, share)}
    if "choice_correct" in episodes:
        correct = episodes["choice_correct"]
        share = wilson(int(np.count_nonzero(correct)), count)
        values |= {"choice": share.estimate, **_bounds("choice", share)}
        reached = episodes["success"][correct]
        values["success_if_chosen"] = float(reached.mean()) if len(reached) else 0.0
    if "chose_old_answer" in episodes:
        values["chose_old_answer"] = float(episodes["chose_old_answer"].mean())
    values["failures"] = len(failures)
    values["failure_distance_mean"] = float(np.mean(failures)) if len(failures) else None
    values["failure_distance_std"] = _std(failures) if len(failures) else None
    values["failure_distance_max"] = float(np.max(failures)) if len(failures) else None
    values["distance_mean"] = float(np.mean(episodes["distance_m"]))
    values["angle_mean"] = float(np.mean(episodes["angle_deg"]))
    return values


def _std(values: np.ndarray) -> float:
    return float(np.std(values, ddof=1)) if len(values) > 1 else 0.0


def _bounds(name: str, interval: Interval) -> dict[str, float]:
    return {f"{name}_low": interval.low, f"{name}_high": interval.high}
