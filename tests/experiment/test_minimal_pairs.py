"""Minimal pairs: an agent that reads the graph acts on every edit, one that does not on none."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.experiment import minimal_pairs
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.evaluation import (
    DamageTest,
    ReasoningTest,
    SplitTest,
)
from knowarm.experiment.load import load_agent
from knowarm.experiment.minimal_pairs import (
    OUTCOMES,
    VERSIONS,
    PairsProbe,
    outcomes,
)
from knowarm.knowledge.queries.queries import QueryGraph
from knowarm.world.agents import Batch, RandomAgent
from knowarm.world.agents.play import play
from knowarm.world.agents.scripted import guide_of
from knowarm.world.config import EnvConfig, questions_of
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks import find_task
from knowarm.world.tasks.probe import Findings
from knowarm.world.tasks.skills.guides import Sight
from knowarm.world.tasks.state import nearest_levels

ROOT = Path(__file__).parents[2]
ANSWERS = ROOT / "zoo" / "irb120-choose-answers-fast"
SUITE_SEED = 7_000_003
CHOOSE = EnvConfig(
    task=find_task("choose"), success_distance_m=0.05, success_angle_deg=15.0
)


class Reader:
    """Knows which facets answer, goes to a visible one of them, and stays where there is none."""

    def __init__(self, env, told):
        self.env = env
        self.told = np.asarray(told)

    def telling(self, rows):
        return Reader(self.env, rows)

    def choose(self, rows, objects, colours):
        """Return the number of the visible object, (n,); -1 stays."""
        visible = self.env.running.first_facet[objects] + colours
        answers = np.take_along_axis(self.told[rows], visible, axis=1)
        return np.where(answers.any(axis=1), answers.argmax(axis=1), -1)

    def reset(self, batch):
        """Solve the way to the chosen object by the simulator's state."""
        state, scene = self.env.running, self.env.scene
        chosen = self.choose(batch.rows, state.objects, state.colours)
        self.stays = chosen < 0
        at = np.arange(len(chosen)), chosen.clip(min=0)
        matrix = scene.grasp_matrix[state.objects[at]].reshape(-1, 9)
        joints = np.stack(list(batch.joints.values()), axis=1)
        position = state.grasp_positions()[at]
        sight = Sight(joints, position, matrix, state.objects, state.positions)
        self.path = guide_of(self.env.config).path(sight)

    def act(self, observations):
        actions = nearest_levels(self.path.error(observations["joint_targets"]))
        return np.where(self.stays[:, None], 0, actions)


class Guesser(Reader):
    """Goes to one of the visible objects at random, whatever it is told."""

    generator = np.random.default_rng(5)

    def telling(self, rows):
        return Guesser(self.env, rows)

    def choose(self, rows, objects, colours):
        return self.generator.integers(objects.shape[1], size=len(objects))


class Looker(Reader):
    """Knows the true answer, and never what it is told: the first of the visible objects."""

    def telling(self, rows):
        return Looker(self.env, rows)

    def choose(self, rows, objects, colours):
        return np.zeros(len(objects), np.int64)


def chosen_at_once(agent, env, episodes):
    """Play without physics: an episode ends where the agent means to go."""
    batch = Batch(env=env.config, names=episodes.question)
    inner = agent
    numbers = batch.rows
    if hasattr(agent, "_change"):
        inner, numbers = agent._agent, agent._change(batch).rows
    chosen = inner.choose(numbers, episodes.objects, episodes.colours)
    count = len(chosen)
    reached = episodes.objects[np.arange(count), chosen.clip(min=0)]
    moves = np.zeros(
        (count, 3, 2), bool
    )  # one of two joints, in the second of three steps
    moves[:, 1, 0] = chosen >= 0
    steps = SimpleNamespace(
        episode=np.arange(count).repeat(3), actions=moves.reshape(-1, 2)
    )
    return SimpleNamespace(
        infos={"reached_object": reached}, steps=steps, length=np.full(count, 3)
    )


def measured(agent, env, episodes, how=play):
    """Return the shares of the outcomes, and the columns."""
    facets = env.facets
    said = []
    played = SimpleNamespace(
        env=env,
        episodes=episodes,
        agent=agent,
        seed=3,
        report=said.append,
        result=how(agent, env, episodes),
        know=lambda graph, query: QueryGraph(graph, facets).answers([query])[0],
    )
    findings = Findings({})
    PairsProbe().measure(played, findings)
    columns = findings.columns
    shares = {}
    for name in OUTCOMES:
        counts = columns["has_foreign" if name == "follows" else "has_pair"]
        shares[name] = columns[name][counts].mean()
    return shares, columns


READS = {
    "pair_right": 1,
    "flips": 1,
    "false_flips": 0,
    "stays": 1,
    "acts": 1,
    "follows": 1,
}


def test_an_oracle_that_reads_the_graph_acts_on_every_edit_and_on_nothing_else():
    env = ArmVectorEnv(CHOOSE, 8, num_threads=1)
    episodes = evaluation_episodes(CHOOSE, 12, SUITE_SEED)
    told = questions_of(CHOOSE).satisfies
    shares, columns = measured(Reader(env, told), env, episodes)
    assert shares == READS
    assert columns["has_pair"].sum() > 4
    assert set(columns["chosen_removal"][columns["has_pair"]]) == {""}


def test_agents_without_physics(monkeypatch):
    """The same oracle, an agent that guesses, and one that never reads what it is told."""
    monkeypatch.setattr(minimal_pairs, "play", chosen_at_once)
    env = ArmVectorEnv(CHOOSE, 1, num_threads=1)
    episodes = evaluation_episodes(CHOOSE, 60, SUITE_SEED)
    told = questions_of(CHOOSE).satisfies
    shares, columns = measured(Reader(env, told), env, episodes, chosen_at_once)
    assert shares == READS
    assert {"shown", "not shown", ""} == set(columns["fact_kind"])
    shares, _ = measured(Looker(env, told), env, episodes, chosen_at_once)
    assert shares == dict.fromkeys(READS, 0) | {"pair_right": 1}
    shares, columns = measured(Guesser(env, told), env, episodes, chosen_at_once)
    count = columns["has_pair"].sum()
    spread = 4 * np.sqrt(0.25 * 0.75 / count)
    assert shares["flips"] == pytest.approx(0.25, abs=spread)
    assert shares["follows"] == pytest.approx(0.25, abs=spread)
    assert shares["pair_right"] == pytest.approx(0.25, abs=spread)
    assert shares["false_flips"] == pytest.approx(0.75, abs=spread)
    assert shares["acts"] < 0.1
    assert shares["stays"] == 0


def test_a_policy_told_its_own_rows_by_episode_moves_as_before():
    """Rows by episode, also where the last batch is filled up, are those of the queries."""
    trained = load_agent(ANSWERS)
    config = trained.config.env
    episodes = evaluation_episodes(config, 5, 3)
    env = ArmVectorEnv(config, 3, num_threads=1)
    before = play(trained.agent, env, episodes)
    rows = {query.name: row for row, query in enumerate(questions_of(config).queries)}
    known = [trained.agent.told[rows[name]] for name in episodes.question]
    told = minimal_pairs.by_episode(trained.agent, known)
    after = play(told, env, episodes)
    assert np.array_equal(before.steps.joint_positions, after.steps.joint_positions)


def test_the_shipped_policy_is_measured_by_the_public_door():
    test = (SplitTest(split="S1"), ReasoningTest(unclear="stop"))
    options = {"episodes": 6, "seed": SUITE_SEED, "distance_m": 0.05, "angle_deg": 15.0}
    result = evaluate(
        ANSWERS, probes=(PairsProbe(),), test=test, write=False, **options
    )
    again = outcomes(result.episodes, result.episodes["target"])
    for name, values in again.items():
        assert np.array_equal(values, result.episodes[name]), name
    has_pair = result.episodes["has_pair"]
    assert 0 < has_pair.sum() < 6
    for name in VERSIONS:
        assert not result.episodes[f"chosen_{name}"][~has_pair].any() or name == "true"
    numbers = result.summary.numbers
    assert numbers["flips"].estimate == result.episodes["flips"][has_pair].mean()
    assert set(result.summary.groups["fact_kind"]) >= {""}
    assert result.summary.label == "post-training-greedy-s1-stop-pairs"


def test_what_has_no_facts_to_edit_is_refused_before_anything_is_played():
    said = []
    options = {"probes": (PairsProbe(),), "write": False, "report": said.append}
    with pytest.raises(UserError, match="Only what trained agents know can be edited"):
        evaluate(RandomAgent(), CHOOSE, **options)
    with pytest.raises(UserError, match="has no queries that a graph could answer"):
        evaluate(ROOT / "zoo" / "irb120-full-fast", **options)
    test = (DamageTest(damage="missing"),)
    with pytest.raises(UserError, match="Leave out damage and repair"):
        evaluate(ANSWERS, test=test, **options)
    assert said == []


def test_episodes_without_a_pair_are_refused():
    env = ArmVectorEnv(CHOOSE, 1, num_threads=1)
    episodes = evaluation_episodes(CHOOSE, 40, SUITE_SEED)
    asks_colour = [name.startswith("hasColor") for name in episodes.question]
    episodes = episodes[np.flatnonzero(asks_colour)[:1]]
    agent = Reader(env, questions_of(CHOOSE).satisfies)
    with pytest.raises(UserError, match="Of 1 episodes none has a minimal pair"):
        measured(agent, env, episodes, chosen_at_once)


def test_edits_do_not_depend_on_how_many_episodes_are_played(monkeypatch):
    monkeypatch.setattr(minimal_pairs, "play", chosen_at_once)
    env = ArmVectorEnv(CHOOSE, 1, num_threads=1)
    agent = Reader(env, questions_of(CHOOSE).satisfies)
    some = evaluation_episodes(CHOOSE, 20, SUITE_SEED)
    _, many = measured(agent, env, some, chosen_at_once)
    _, few = measured(agent, env, some[:8], chosen_at_once)
    for name in ("fact", "new_answer", "fact_kind"):
        assert np.array_equal(many[name][:8], few[name])
