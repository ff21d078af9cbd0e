"""Minimal pairs: whether an agent acts on a fact, by episodes that differ in one triple only."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice, repeat
from typing import Any, Literal, get_args

import numpy as np

from knowarm.arrays import Integers, Mask, Names
from knowarm.errors import UserError
from knowarm.experiment.knows import asked
from knowarm.experiment.other_graphs import check_graph, target_names
from knowarm.knowledge import KnowledgeGraph
from knowarm.knowledge.graph.terms import local_name
from knowarm.knowledge.queries.minimal_pairs import EditKind, MinimalPair, Question
from knowarm.knowledge.queries.queries import parse_query
from knowarm.measures import Columns
from knowarm.world.agents import Batch
from knowarm.world.agents.play import EpisodeResults, play
from knowarm.world.agents.scripted import InformedAgent
from knowarm.world.config import facets_of
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.probe import BaseProbe, Findings, ReportTable
from knowarm.world.tasks.sampling import Episodes

VERSIONS = ("true", *get_args(EditKind), "foreign")
"""What the agent is given in the versions of an episode, whose image and question are the same: the
graph, the graph after an edit, the question of another visible object."""
TEXTS = (
    "fact_kind",
    "fact",
    "new_answer",
    "told_answer",
    *map("chosen_{}".format, VERSIONS),
)
"""Columns of text, see ``evaluation.toml``; they are empty without a minimal pair."""
OUTCOMES = ("pair_right", "flips", "false_flips", "stays", "follows", "acts")
"""Columns of outcomes."""


@dataclass(frozen=True, kw_only=True)
class PairsProbe(BaseProbe):
    """Play each episode again with one triple edited, removed, or another question given.

    Only episodes count whose question allows all edits (`Question.minimal_pair`).
    """

    label = "pairs"
    about = "Play each episode again with one fact edited: minimal pairs."
    table = ReportTable(
        name="minimal-pairs",
        title="Does it act on the fact?",
        measures=OUTCOMES,
        note="Episodes with the same image and question, in which one triple of the graph that the "
        "agent knows is edited: flips, the fact that decides given to another visible object; "
        "false flips, a triple of the same relation and value moved between objects out of sight; "
        "stays, the fact removed; follows, given the question of another visible object.",
    )
    kind: Literal["pairs"] = "pairs"

    def measure(self, played: Any, findings: Findings) -> None:
        """Add where the agent ends in each version, and the outcomes, (n,) each."""
        env = played.env
        agent = played.agent
        episodes = played.episodes
        graph = env.config.task.asked.answering_graph(env.facets)
        pairs = dict(_minimal_pairs(env, episodes, graph, played.seed))
        if not pairs:
            raise UserError(
                f"Of {len(episodes)} episodes none has a minimal pair: a fact that decides, "
                "and that another visible object could have. Play more episodes."
            )
        rows = np.array(list(pairs))
        names = np.array([target.name for target in env.scene.targets])
        visible = names[episodes.objects]
        columns = {}
        for name in TEXTS:
            columns[name] = np.full(len(episodes), "", object)
        columns["chosen_true"][:] = _chosen(played.result, names)
        for version in get_args(EditKind):
            played.report(f"Minimal pairs, {version}: {len(pairs):,} episodes.")
            told = []
            for row, pair in pairs.items():
                query = parse_query(episodes.question[row])
                told.append(played.know(pair.edits[version].apply(graph), query))
            ended = play(by_episode(agent, told), env, episodes[rows])
            columns[f"chosen_{version}"][rows] = _chosen(ended, names)
        questions, answers = other_questions(env, episodes, played.seed)
        has_other = np.isin(np.arange(len(episodes)), rows) & (questions != "")
        if has_other.any():
            misinformed = told_questions(agent, env, questions[has_other])
            ended = play(misinformed, env, episodes[has_other])
            columns["chosen_foreign"][has_other] = _chosen(ended, names)
        columns["told_answer"][has_other] = visible[has_other, answers[has_other]]
        for row, pair in pairs.items():
            columns["fact_kind"][row] = "shown" if pair.is_shown else "not shown"
            columns["fact"][row] = " ".join(map(local_name, pair.fact))
            columns["new_answer"][row] = visible[row, pair.heir]
        findings.columns |= columns | outcomes(columns, visible[:, 0])


def outcomes(columns: Columns, right: Names) -> dict[str, Mask]:
    """Return the outcomes, (n,) bool each, from where an agent ends; ``right`` (n,) is the answer.

    They are False without a minimal pair.
    """
    has_pair = np.asarray(columns["fact_kind"] != "")
    has_foreign = has_pair & (columns["told_answer"] != "")
    chosen = {name: columns[f"chosen_{name}"] for name in VERSIONS}
    is_right = has_pair & (chosen["true"] == right)
    flips = has_pair & (chosen["deciding"] == columns["new_answer"])
    return {
        "has_pair": has_pair,
        "has_foreign": has_foreign,
        "pair_right": is_right,
        "flips": flips,
        "false_flips": has_pair & (chosen["placebo"] != chosen["true"]),
        "stays": has_pair & (chosen["removal"] == ""),
        "follows": has_foreign & (chosen["foreign"] == columns["told_answer"]),
        "acts": is_right & flips & (chosen["placebo"] == right),
    }


def check_pairs(subject: Any) -> None:
    """Refuse what has no facts to edit, before anything is played.

    Raises:
        UserError: an agent that was not trained, a task without a graph that answers its queries,
            or an agent that knows another graph.
    """
    if subject.config is None:
        raise UserError(
            "Only what trained agents know can be edited for minimal pairs. Leave them out, or "
            "pass a run folder."
        )
    asked(subject.env)
    graph = subject.env.task.asked.answering_graph(facets_of(subject.env))
    if graph is None:
        raise UserError(
            "The questions of this task are names, which no graph answers, so no fact can be "
            "edited. Leave minimal pairs out, or take a run of the choose task."
        )
    check_graph(subject.config, subject.env)
    if subject.graph is not None and subject.graph != graph:
        raise UserError(
            "Minimal pairs edit the graph that answers the questions, and here the agent knows "
            "another one. Leave out damage and repair."
        )


def by_episode(agent: Any, knowledge: Sequence[Any]) -> InformedAgent:
    """Return an agent that is given a row, (D,), for each of some episodes, played in order."""
    last = len(knowledge) - 1
    numbers = chain(range(last), repeat(last))  # `play` repeats the last one

    def number(batch: Batch) -> Batch:
        rows = np.fromiter(islice(numbers, batch.size), np.int64)
        return replace(batch, own_rows=rows)

    return InformedAgent(agent.telling(knowledge), number)


def told_questions(agent: Any, env: ArmVectorEnv, questions: Names) -> InformedAgent:
    """Return an agent that is given other questions in some episodes (n,), played in order."""
    rows = Batch(env=env.config, names=questions).rows
    return by_episode(agent, agent.told[rows])


def _minimal_pairs(
    env: ArmVectorEnv, episodes: Episodes, graph: KnowledgeGraph, seed: int
) -> Iterator[tuple[int, MinimalPair]]:
    """Yield the minimal pairs with the numbers of their episodes."""
    targets = target_names(env.config)
    for row, visible in enumerate(_visible(env, episodes).tolist()):
        facets = [env.facets[number] for number in visible]
        others = [name for name in targets if name not in dict(facets)]
        query = parse_query(episodes.question[row])
        question = Question(graph, query, facets, others)
        pair = question.minimal_pair(np.random.default_rng([seed, row]))
        if pair is not None:
            yield row, pair


def _visible(env: ArmVectorEnv, episodes: Episodes) -> Integers:
    """Return the numbers of the visible facets, (n, m)."""
    return np.asarray(env.running.first_facet[episodes.objects] + episodes.colours)


def _chosen(result: EpisodeResults, names: Names) -> Names:
    """Return the object at which each episode ends; nothing where no joint was ever moved."""
    steps = result.steps
    moved = np.zeros(len(result.length), bool)
    moved[steps.episode[steps.actions.any(axis=1)]] = True
    return np.where(moved, names[result.infos["reached_object"]], "")


def other_questions(
    env: ArmVectorEnv, episodes: Episodes, seed: int
) -> tuple[Names, Integers]:
    """Draw a question that exactly one visible object answers, another than the right one, (n,).

    It is one that the task asks; empty where the visible objects allow none. The second array is
    the number of the visible object that answers it.
    """
    table = asked(env.config)
    answers = table.satisfies[:, _visible(env, episodes)]  # (Q, n, m)
    is_asked = np.asarray(table.askable.any(axis=1))
    fits = (answers.sum(2) == 1) & ~answers[..., 0] & is_asked[:, None]
    drawn = (np.random.default_rng(seed).random(fits.shape) * fits).argmax(0)
    names = np.array([query.name for query in table.queries])
    answering = answers[drawn, np.arange(len(drawn))].argmax(1)
    return np.where(fits.any(0), names[drawn], ""), answering
