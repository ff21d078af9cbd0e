"""Evaluation of an agent on fixed episodes (paper section 4.2.4)."""

import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from knowarm.arrays import Mask
from knowarm.config import override, to_dict
from knowarm.errors import UserError
from knowarm.experiment.evaluation import EvaluationConfig, Subject
from knowarm.experiment.knows import answers_by_graph, reason_by
from knowarm.experiment.load import TrainedAgent, load_agent
from knowarm.experiment.probes import Played
from knowarm.experiment.run import Run
from knowarm.experiment.summary import (
    WIDE_ANGLE_DEG,
    Summary,
    episode_types,
    step_columns,
    summarize,
    write_film,
    write_table,
)
from knowarm.knowledge import KnowledgeGraph
from knowarm.measures import Measure
from knowarm.perception.calibration import covered
from knowarm.perception.solving import player
from knowarm.policy import PolicyAgent
from knowarm.questions import Query
from knowarm.reading import write_json, writing
from knowarm.world.agents import AgentProtocol
from knowarm.world.agents.play import EpisodeResults, play
from knowarm.world.config import EnvConfig, facets_of, row_names
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.robots import find_robot
from knowarm.world.tasks.probe import Findings
from knowarm.world.tasks.sampling import Episodes
from knowarm.world.tasks.state import NamedArrays


@dataclass(frozen=True, repr=False)
class EvaluationResult:
    """Everything that one evaluation measured.

    Attributes:
        summary: numbers, and the settings they were measured with.
        episodes: columns of ``episodes.parquet``, one row per episode.
        steps: columns of ``steps.parquet``, one row per step; None where not recorded.
        films: one (T, H, W, 3) uint8 array for each recorded episode, the agent's observations.
        folder: of the files: ``<run>/evaluation/<label>/`` for a trained agent, else None.
        meanings: what the columns hold that the task and the probes add.
    """

    summary: Summary
    episodes: NamedArrays
    steps: NamedArrays | None = None
    films: Sequence[np.ndarray] = ()
    folder: Path | None = None
    meanings: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Return agent, episodes, success and return in one line."""
        summary = self.summary
        return (
            f"EvaluationResult({summary.agent}, {summary.label}: {summary['episodes']:,.0f} "
            f"episodes, success {100 * summary['success']:.1f} %, "
            f"return {summary['return_mean']:.1f})"
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
        if folder is None:
            folder = self.folder
        if folder is None:
            raise UserError(
                "This evaluation belongs to no run: pass a folder to write it to."
            )
        folder = Path(folder)
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            for name in ("summary.json", "steps.parquet"):
                (folder / name).unlink(missing_ok=True)
            shutil.rmtree(folder / "films", ignore_errors=True)
        types = episode_types(self.episodes, self.meanings)
        write_table(folder / "episodes.parquet", self.episodes, types)
        if self.steps is not None:
            joints = sum(name.startswith("joint_") for name in self.steps)
            write_table(folder / "steps.parquet", self.steps, step_columns(joints))
        for number, frames in enumerate(self.films):
            write_film(folder / "films" / f"{number}.webp", frames)
        write_json(folder / "summary.json", to_dict(self.summary))
        return folder


BATCH = 128
"""Most episodes played in parallel; another batch size rounds sums differently."""


MakeAgent = Callable[[ArmVectorEnv], AgentProtocol]
Playable = AgentProtocol | MakeAgent | TrainedAgent | Run | Path | str


def evaluate(
    agent: Playable,
    env_config: EnvConfig | None = None,
    config: EvaluationConfig | None = None,
    *,
    agent_name: str = "agent",
    write: bool = True,
    report: Callable[[str], None] = lambda line: None,
    **overrides: Any,
) -> EvaluationResult:
    """Play the fixed episodes and measure returns, accuracy and success.

    Agents evaluated with equal configs play the same episodes.

    Args:
        agent: what `train` or `load_agent` returned, a run folder, any `AgentProtocol`, or what
            makes one for an environment, such as the class `OracleAgent`.
        env_config: the task; its success thresholds are replaced by those of ``config``. None
            takes the task that a trained agent was trained on.
        config: episodes, test conditions and probes; None takes the defaults.
        agent_name: name in the summary; a trained agent has the name of its run.
        write: store the result in the run's folder, ``<run>/evaluation/<label>/``; without effect
            for an agent without a run.
        report: receives lines on the progress.
        **overrides: fields of ``config`` to change, such as ``episodes=200``.

    Returns:
        The result, with the columns of every episode.

    Raises:
        UserError: a run folder that cannot be loaded or written to, an agent without a task, or a
            condition or probe that does not fit agent or task.
    """
    config = override(config or EvaluationConfig(), overrides)
    agent, trained = _loaded(agent, config)
    subject = _subject(trained, env_config, own_folder=write and not config.label)
    stated = config.of_robot(find_robot(subject.env.robot))
    if stated != config:
        report(
            f"Judged within {100 * stated.distance_m:g} cm and {stated.angle_deg:g} degrees, as "
            f"{subject.env.robot} states."
        )
        config = stated
    subject = config.prepare(subject)
    is_trained = False
    folder = None
    if trained is not None:
        is_trained = trained.which != "untrained"
        if trained.which != "best":
            config = replace(config, label=f"{config.folder}-{trained.which}")
        agent_name = f"{trained.config.name}/{trained.config.seed}"
        folder = trained.folder.evaluation(config.folder)
    task = subject.env.task
    measures: list[Measure] = []
    meanings = task.column_meanings
    with closing(ArmVectorEnv(subject.env, min(BATCH, config.episodes))) as env:
        agent = agent_for_test(agent, trained, subject, env)
        for probe in config.probes:
            probe.check(env.scene, task.name)
            measures += probe.measures
            meanings |= probe.column_meanings
        fixed = _episodes(env, config)
        report(f"Playing {len(fixed):,} episodes.")
        result = play(agent, env, fixed, record_images=config.films, report=report)
        columns = episode_columns(subject, result, env, config)
        know = None if trained is None else partial(_told_by, trained, subject)
        played = Played(
            agent, env, fixed, result, config.seed, is_trained, report, know
        )
        findings = Findings(columns)
        for probe in config.probes:
            probe.measure(played, findings)
    numbers, groups = summarize(findings.columns, [*measures, *task.measures])
    summary = Summary(
        agent=agent_name,
        label=config.folder,
        config=config,
        env=to_dict(config.stored(subject.env)),
        joints=tuple(env.scene.joint_names),
        numbers=numbers | findings.numbers,
        groups=groups | findings.groups,
    )
    measured = EvaluationResult(
        summary, findings.columns, findings.steps, result.images, folder, meanings
    )
    if write and folder is not None:
        measured.write()
    return measured


def _loaded(
    agent: Playable, config: EvaluationConfig
) -> tuple[AgentProtocol | MakeAgent, TrainedAgent | None]:
    """Return what plays, or makes it, and the trained agent, if any, ready to draw actions."""
    if isinstance(agent, Run):
        agent = agent.folder.path
    greedy = config.actions == "greedy"
    if isinstance(agent, str | Path):
        agent = load_agent(agent, greedy=greedy, seed=config.seed)
    if not isinstance(agent, TrainedAgent):
        if not greedy:
            raise UserError(
                "Only trained agents can be evaluated with actions. Leave it out, or pass a run "
                "folder."
            )
        return agent, None
    if agent.agent.greedy != greedy:
        raise UserError(
            f"The agent was loaded with greedy={agent.agent.greedy}, and actions is "
            f"{config.actions!r}. Pass its run folder, or load it with the other greedy."
        )
    if agent.agent.generator is not None:  # another evaluation may have drawn from it
        agent.agent.generator.manual_seed(config.seed)
    return agent.agent, agent


def _subject(
    trained: TrainedAgent | None,
    env: EnvConfig | None,
    *,
    own_folder: bool,
) -> Subject:
    """Return what is evaluated before the conditions of the test apply."""
    if trained is None:
        if env is None:
            raise UserError(
                "This agent has no task of its own: pass env_config=EnvConfig(...)."
            )
        return Subject(env=env)
    played = env or trained.config.env
    if own_folder and played != trained.training:
        raise UserError(
            "This task is not the agent's own, and its evaluation would replace that in the run "
            "folder. Give it a label=..., or set write=False."
        )
    solves = trained.config.solves
    return Subject(env=played, config=trained.config, solves=solves)


def agent_for_test(
    agent: AgentProtocol | MakeAgent,
    trained: TrainedAgent | None,
    subject: Subject,
    env: ArmVectorEnv,
) -> AgentProtocol:
    """Return the agent that plays a test, with what it knows in it."""
    if trained is None:
        is_made = hasattr(agent, "act") and not isinstance(agent, type)
        if is_made:
            return cast(AgentProtocol, agent)
        return cast(MakeAgent, agent)(env)
    informed = known_in_test(trained, subject)
    check_fits(trained, env, knows_task=informed is not trained.agent)
    return player(
        informed,
        subject.env,
        subject.known_places,
        solves=subject.solves,
        hears=subject.places != "unknown",
        swaps=subject.places == "swapped",
    )


def _told_by(
    trained: TrainedAgent, subject: Subject, graph: KnowledgeGraph, query: Query
) -> Any:
    """Return the row of a query, (D,), of an agent in a test that knows another graph."""
    told = replace(subject, graph=graph, queries=(query,))
    return known_in_test(trained, told).told[0]


def known_in_test(trained: TrainedAgent, subject: Subject) -> PolicyAgent:
    """Return a trained agent with what it knows in a test."""
    config = subject.trained
    env = subject.env
    reasoning = subject.reasoning
    knows = reason_by(config.knows, reasoning, config.agent)
    is_unclear = subject.unclear != "guess" or subject.level is not None
    if is_unclear and not answers_by_graph(knows):
        raise UserError(
            f"unclear={subject.unclear!r} and level are for agents that answer by a graph, and "
            f"{config.agent!r} does not. Leave them out, or reason by the graph."
        )
    is_own = subject.graph is None and reasoning is None and config is trained.config
    shows_own = is_own and facets_of(env) == facets_of(config.env)
    asks_own = shows_own and env.task.asked == config.env.task.asked
    if is_own and not answers_by_graph(knows):
        return trained.agent
    if asks_own and not is_unclear:
        return trained.agent
    table = None
    if shows_own:
        table = trained.table
    knowledge = knows.known(
        env,
        config.seed,
        table=table,
        graph=subject.graph,
        trained=config.env,
        queries=subject.queries,
        network=trained.network,
        reasoning=reasoning,
    )
    options: dict[str, Any] = {}
    if is_unclear:
        options["unclear"] = subject.unclear
    if subject.level is not None:
        options["thresholds"] = trained.thresholds(subject.level)
    return trained.with_knowledge(knowledge, **options)


def check_fits(trained: TrainedAgent, env: ArmVectorEnv, *, knows_task: bool) -> None:
    """Check that an agent, with knowledge of the task or of its own, can play in an environment."""
    shape = trained.policy.shape
    of_agent: Any = (shape.joints, shape.image_size)
    of_env: Any = (env.scene.num_joints, env.config.image_size)
    name = "joints, image size"
    reads_rows = trained.policy.uses_knowledge and not knows_task
    if of_agent == of_env and reads_rows:
        of_agent = row_names(trained.config.env)
        of_env = row_names(env.config)
        name = "knowledge of"
    if of_agent != of_env:
        raise UserError(
            f"{trained.config.name} does not fit this environment (agent | environment): "
            f"{name} {of_agent!s:.80} | {of_env!s:.80}. Evaluate it in one like its own."
        )


def episode_columns(
    subject: Subject,
    result: EpisodeResults,
    env: ArmVectorEnv,
    config: EvaluationConfig,
) -> NamedArrays:
    """Return the columns of ``episodes.parquet``, (n,) each."""
    infos = result.infos
    notes = result.notes
    count = len(result.length)
    seeds = config.seed + np.arange(config.seeds)
    targets = np.array([target.name for target in env.scene.targets])
    columns = {
        "episode": np.arange(count),
        "evaluation_seed": np.repeat(seeds, count // config.seeds),
        "target": targets[infos["target"]],
        "facet": infos["facet"],
        "return": result.episode_return,
        "length": result.length,
        "distance_m": result.distance,
        "angle_deg": result.angle,
        "success": result.success,
        "accurate": result.distance <= config.distance_m,
        "success_wide": _ever_wide_success(result, config),
    }
    columns |= env.config.task.columns(env.running.setting, infos)
    for condition in config.test:
        columns |= condition.columns(env.config, columns)
    if "candidates" in notes:  # of an agent that answers by a graph
        candidates = notes["candidates"]
        columns["visible_answers"] = candidates.sum(1)
        if subject.level is not None:
            right = infos["object_positions"][:, 0]
            size = env.config.image_size
            is_covered = covered(notes["places"], candidates, env.scene, right, size)
            columns["covered"] = is_covered
    return columns


def _ever_wide_success(result: EpisodeResults, config: EvaluationConfig) -> Mask:
    """Return (N,) bool: success with the wider angle.

    Until an episode meets the wider threshold, both thresholds give the same steps.
    """
    steps = result.steps
    wide = max(WIDE_ANGLE_DEG, config.angle_deg)
    near = (steps.distance <= config.distance_m) & (steps.angle <= wide)
    success = result.success.copy()
    success[steps.episode[near]] = True
    return success


def _episodes(env: ArmVectorEnv, config: EvaluationConfig) -> Episodes:
    """Draw the fixed episodes: equal shares of each evaluation seed, in order."""
    share = config.episodes // config.seeds
    seeds = range(config.seed, config.seed + config.seeds)
    lists = [evaluation_episodes(env.config, share, seed) for seed in seeds]
    columns = zip(*[vars(part).values() for part in lists], strict=True)
    return Episodes(*map(np.concatenate, columns))
