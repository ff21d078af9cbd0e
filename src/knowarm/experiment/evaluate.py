"""Evaluation of an agent on fixed episodes (paper section 4.2.4)."""

import dataclasses
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from knowarm.config import override, to_dict
from knowarm.errors import UserError
from knowarm.experiment.config import EvaluationConfig
from knowarm.experiment.evaluation_files import (
    episode_columns,
    episode_types,
    lift_columns,
    step_columns,
    step_values,
    write_film,
    write_table,
)
from knowarm.experiment.graph_at_test import (
    answer_table,
    graph_at_test,
    knowledge_at_test,
    with_graph,
)
from knowarm.experiment.load import TrainedAgent, load_agent, policy_agent
from knowarm.experiment.run import Run
from knowarm.experiment.summary import Summary, summarize
from knowarm.knowledge import KnowledgeGraph
from knowarm.perception.answering import AnsweringAgent
from knowarm.reading import write_json, writing
from knowarm.statistics import Interval, share_difference, wilson
from knowarm.world.agents import BLIND_AGENTS, AgentProtocol
from knowarm.world.agents.play import play
from knowarm.world.config import EnvConfig, facets_of
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.lifting.model import lifting_model
from knowarm.world.tasks.episodes import Episodes, evaluation_episodes


@dataclass(frozen=True, repr=False)
class EvaluationResult:
    """Everything that one evaluation measured.

    Attributes:
        summary: numbers, and the settings they were measured with.
        episodes: columns of ``episodes.parquet``, one row per episode.
        steps: columns of ``steps.parquet``, one row per step; None where not recorded.
        films: one (T, H, W, 3) uint8 array for each recorded episode, the agent's observations.
        folder: of the files: ``<run>/evaluation/<label>/`` for a trained agent, else None.
        meanings: what the columns hold that the task adds.
    """

    summary: Summary
    episodes: dict[str, np.ndarray]
    steps: dict[str, np.ndarray] | None = None
    films: Sequence[np.ndarray] = ()
    folder: Path | None = None
    meanings: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Return agent, episodes, success and return in one line."""
        numbers = self.summary
        return (
            f"EvaluationResult({numbers.agent}, {numbers.label}: {numbers['episodes']:,.0f} "
            f"episodes, success {100 * numbers['success']:.1f} %, "
            f"return {numbers['return_mean']:.1f})"
        )

    def write(self, folder: Path | str | None = None) -> Path:
        """Write ``episodes.parquet``, ``steps.parquet``, ``films/``, and last ``summary.json``.

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
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            for name in ("summary.json", "steps.parquet"):
                (folder / name).unlink(missing_ok=True)
            shutil.rmtree(folder / "films", ignore_errors=True)
        write_table(
            folder / "episodes.parquet", self.episodes, episode_types(self.episodes, self.meanings)
        )
        if self.steps is not None:
            joints = sum(name.startswith("joint_") for name in self.steps)
            write_table(folder / "steps.parquet", self.steps, step_columns(joints))
        for number, frames in enumerate(self.films):
            write_film(folder / "films" / f"{number}.webp", frames)
        write_json(folder / "summary.json", to_dict(self.summary))
        return folder


FOR_TRAINED = ("actions", "graph", "reasoning", "unclear", "damage", "repair")
"""Settings that change what a trained agent knows or does."""


def evaluate(
    agent: AgentProtocol | TrainedAgent | Run | Path | str,
    env_config: EnvConfig | None = None,
    config: EvaluationConfig | None = None,
    *,
    agent_name: str = "agent",
    write: bool = True,
    **overrides: Any,
) -> EvaluationResult:
    """Play the fixed episodes and measure returns, accuracy and success.

    Agents evaluated with equal configs play the same episodes. Beside a trained agent, the blind
    agents play the first ``config.blind_episodes`` of them: see `blind_numbers`.

    Args:
        agent: what `train` or `load_agent` returned, a run folder, or any object with
            ``start(env)`` and ``act(images)``.
        env_config: the task; its success thresholds are replaced by those of ``config``. None
            takes the task that a trained agent was trained on.
        config: episodes and thresholds; None takes the defaults.
        agent_name: name in the summary; a trained agent has the name of its run.
        write: store the result in the run's folder, ``<run>/evaluation/<label>/``; without effect
            for an agent without a run.
        **overrides: fields of ``config`` to change, such as ``episodes=200``.

    Returns:
        The result, with the columns of every episode.

    Raises:
        UserError: a run folder that cannot be loaded or written to, an agent without a task,
            held-out episodes of an environment that holds none out, or a lift by a robot without
            fingers.
    """
    config = override(config or EvaluationConfig(), overrides)
    if isinstance(agent, Run):
        agent = agent.folder.path
    if isinstance(agent, str | Path):
        agent = load_agent(agent, greedy=config.actions == "greedy", seed=config.seed)
    folder, blind_episodes, trained = None, 0, None
    if isinstance(agent, TrainedAgent):
        if agent.agent.greedy != (config.actions == "greedy"):
            raise UserError(
                f"The agent was loaded with greedy={agent.agent.greedy}, and actions is "
                f"{config.actions!r}. Pass its run folder, or load it with the other greedy."
            )
        if agent.agent.generator is not None:  # another evaluation may have drawn from it
            agent.agent.generator.manual_seed(config.seed)
        blind_episodes = config.blind_episodes if agent.which != "untrained" else 0
        if config.graph is not None:
            agent = dataclasses.replace(agent, config=with_graph(agent.config, config.graph))
        if write and env_config not in (None, agent.config.env) and config.label is None:
            raise UserError(
                "This task is not the agent's own, and its evaluation would replace that in the "
                "run folder. Give it a label=..., or set write=False."
            )
        if agent.which != "best":
            config = dataclasses.replace(config, label=f"{config.folder}-{agent.which}")
        env_config = env_config or agent.config.env
        agent_name = f"{agent.config.name}/{agent.config.seed}"
        folder = agent.folder.evaluation(config.folder)
        trained, agent = agent, agent.agent
    elif changed := [n for n in FOR_TRAINED if getattr(config, n) != getattr(EvaluationConfig, n)]:
        raise UserError(
            f"Only trained agents can be evaluated with {', '.join(changed)}. Leave it out, or "
            "pass a run folder."
        )
    if env_config is None:
        raise UserError("This agent has no task of its own: pass env_config=EnvConfig(...).")
    judged = env_for_test(env_config, config)
    env = ArmVectorEnv(judged, min(config.num_envs, config.episodes))
    table: torch.Tensor | None = None
    try:
        if trained is not None:
            agent, table = agent_for_test(trained, judged, config)
            check_fits(trained, env, knows_task=table is not None or agent is not trained.agent)
        fixed = _episodes(env, config)
        if config.lift and judged.task.solid:
            raise UserError("lift=True lifts where episodes of a task without solid objects end.")
        if config.lift:  # a robot without fingers is found before anything is played
            lifting_model(env.scene.robot, env.scene.targets[:1])
        result = play(agent, env, fixed, record_images=config.record_films)
        if isinstance(agent, AnsweringAgent):  # the last batch repeats its last episode
            visible = np.concatenate(agent.log)[: len(fixed)]
        blind, gain = blind_numbers(agent, result.success, env, fixed, blind_episodes, config.seed)
        episodes = episode_columns(result, env, config)
        if isinstance(agent, AnsweringAgent):
            episodes["visible_answers"] = visible
        if config.lift:
            episodes |= lift_columns(result, env.scene, fixed)
        steps = step_values(result) if config.record_steps else None
    finally:
        env.close()
        if trained is not None and table is not None:
            trained.set_knowledge_table(table)
    found = summarize(episodes, judged.task.measures)
    found["numbers"] |= gain
    summary = Summary(
        agent=agent_name,
        label=config.folder,
        config=config,
        env=to_dict(judged),
        joints=tuple(env.scene.joint_names),
        numbers=found["numbers"],
        groups=found["groups"] | blind,
    )
    measured = EvaluationResult(
        summary, episodes, steps, result.images, folder, judged.task.column_meanings
    )
    if write and folder is not None:
        measured.write()
    return measured


def count_blind_episodes(config: EvaluationConfig) -> int:
    """Count the episodes that all blind agents play in an evaluation."""
    return len(BLIND_AGENTS) * min(config.blind_episodes, config.episodes)


def blind_numbers(
    agent: AgentProtocol,
    success: np.ndarray,
    env: ArmVectorEnv,
    episodes: Episodes,
    count: int,
    seed: int,
) -> tuple[dict[str, Any], dict[str, Interval]]:
    """Play the first ``count`` of an agent's N episodes with the blind agents, and compare.

    ``success`` (N,) bool is the agent's. Returns the group ``blind``, by name of the agent its
    ``episodes``, ``success`` and ``difference``, the success of the agent over all episodes minus
    its own; and ``vision_gain``, the smallest difference to an agent that sees nothing.
    """
    if not count:
        return {}, {}
    chosen = episodes[:count]
    own = wilson(int(np.count_nonzero(success)), len(success))
    numbers: dict[str, dict[str, Any]] = {}
    for name, entry in BLIND_AGENTS.items():
        solved = play(entry.make(agent, seed), env, chosen).success
        share = wilson(int(np.count_nonzero(solved)), len(solved))
        difference = share_difference(own, share)
        numbers[name] = {
            "episodes": float(len(solved)),
            "success": share,
            "difference": difference,
        }
    seeing = (numbers[n]["difference"] for n, e in BLIND_AGENTS.items() if e.sees_nothing)
    return {"blind": numbers}, {"vision_gain": min(seeing, key=lambda each: each.estimate)}


def agent_for_test(
    trained: TrainedAgent,
    env: EnvConfig,
    config: EvaluationConfig,
    graph: KnowledgeGraph | None = None,
) -> tuple[AgentProtocol, torch.Tensor | None]:
    """Return the agent with what it knows in this evaluation, and a table to restore after it.

    ``env`` is of `env_for_test`; ``graph`` replaces the graph of the questions.
    """
    graph, network = graph_at_test(trained.config, env, config, graph), trained.network
    reasoning = config.reasoning or trained.config.reasoning
    if config.reasoning and network is None:
        raise UserError(
            f"The agent {trained.config.agent!r} has no grounding network, so reasoning cannot be "
            "chosen. Leave reasoning out, or take a run such as zoo/irb120-choose-subgraph-fast."
        )
    if reasoning == "vector":
        if config.unclear != "guess":
            raise UserError(
                f"unclear={config.unclear!r} is for agents that answer by a graph, and "
                f"{trained.config.agent!r} knows a vector. Leave it out, or set reasoning='graph'."
            )
        if graph is None and config.reasoning is None and config.graph is None:
            return trained.agent, None
        agent = trained.agent
        if config.reasoning:  # the network compares the query's vector with places
            agent = policy_agent(trained.policy, network, agent.greedy, agent.generator)
        changed = torch.from_numpy(knowledge_at_test(trained.config, env, graph))
        return agent, trained.set_knowledge_table(changed)
    assert network is not None  # of every agent that answers by a graph
    control = None if reasoning == "graph" else reasoning
    facets = network.spec.facets
    answers = answer_table(trained.config, env, facets, graph=graph, control=control)
    return trained.answering(answers, config.unclear), None


def check_fits(trained: TrainedAgent, env: ArmVectorEnv, *, knows_task: bool) -> None:
    """Check that an agent, with knowledge of the task or of its own, can play in an environment."""
    own, new = trained.policy.shape, (env.scene.num_joints, env.config.image_size)
    found: dict[str, Any] = {"joints, image size": ((own.joints, own.image_size), new)}
    indexes = trained.policy.uses_knowledge and (trained.module is None or trained.network)
    if indexes and not knows_task:
        both = (trained.config.env, env.config)
        found["knowledge of"] = [each.task.knowledge_rows(facets_of(each)) for each in both]
    for name, (one, other) in found.items():
        if one != other:
            raise UserError(
                f"{trained.config.name} does not fit this environment (agent | environment): "
                f"{name} {one!s:.80} | {other!s:.80}. Evaluate it in one like its own."
            )


def env_for_test(env_config: EnvConfig, config: EvaluationConfig) -> EnvConfig:
    """Return the task of an evaluation: with its thresholds, split and held-out episodes."""
    held_out = env_config.held_out
    if config.held_out:
        if held_out is None:
            raise UserError(
                "held_out=True plays episodes that were excluded from training, and this "
                "environment holds none out. Train with env.held_out, or leave held_out out."
            )
        held_out = dataclasses.replace(held_out, play="held_out")
    task = env_config.task
    if config.split is not None:
        task = task.for_split(config.split, config.edited)
    return dataclasses.replace(
        env_config,
        success_distance_m=config.distance_m,
        success_angle_deg=config.angle_deg,
        held_out=held_out,
        task=task,
    )


def _episodes(env: ArmVectorEnv, config: EvaluationConfig) -> Episodes:
    """Draw the fixed episodes: equal shares of each evaluation seed, in order."""
    share = config.episodes // config.seeds
    lists = [evaluation_episodes(env.config, share, config.seed + i) for i in range(config.seeds)]
    names = [field.name for field in dataclasses.fields(Episodes)]
    return Episodes(*(np.concatenate([getattr(each, name) for each in lists]) for name in names))
