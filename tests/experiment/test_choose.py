"""Experiments of the choose task: names, training, evaluation and its splits."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from knowarm.config import override
from knowarm.errors import UserError
from knowarm.experiment.agents import AGENTS
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.evaluation import SplitTest, Subject
from knowarm.experiment.load import load_agent
from knowarm.experiment.names import experiment_config, tasks_of
from knowarm.experiment.run import Run, build
from knowarm.world.agents import OracleAgent
from knowarm.world.config import EnvConfig, questions_of
from knowarm.world.tasks.asked.query.query import AskObject
from knowarm.world.tasks.asked.query.query_source import GraphQueries, NameQueries
from tests.tiny import CHOOSE_ENV


def test_the_image_marks_the_object_for_the_upper_bound_only() -> None:
    for name, agent in AGENTS.items():
        if "choose" in tasks_of(agent):
            config = experiment_config(f"irb120-choose-{name}-fast")
            assert isinstance(config.env.task.asked, AskObject)
            assert config.env.task.asked.marked == (name == "mask")
            assert agent.asked == ({"marked": True} if name == "mask" else {})


def test_a_task_may_change_the_settings_of_an_algorithm(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    training = {"fast": {"total_steps": 7, "algorithm": {"gamma": 0.5}}}
    monkeypatch.setattr(
        AskObject, "training", lambda self, algorithm: training.get(algorithm, {})
    )
    reach, choose = (
        experiment_config(f"irb120-{name}-fast") for name in ("bm", "choose-bm")
    )
    assert (choose.total_steps, choose.algorithm) == (
        7,
        replace(reach.algorithm, gamma=0.5),
    )
    assert reach.total_steps == ALGORITHMS["fast"].total_steps


def test_training_and_evaluation_report_the_choice(
    choose_run: Run, tmp_path: Path
) -> None:
    header = (choose_run.folder.path / "evaluations.csv").read_text().splitlines()[0]
    assert "choice" in header.split(",")
    result = evaluate(
        choose_run.folder.path,
        episodes=8,
        probes=(),
        test=(SplitTest(split="S2"),),
        write=False,
    )
    folder = result.write(tmp_path / result.summary.label)
    assert folder.name == "post-training-greedy-s2"
    assert result.summary["choice_chance"] == 0.25
    assert {"query", "chosen", "choice_correct"} <= result.episodes.keys()
    assert result.summary.groups["query"]


def test_the_policy_receives_knowledge_of_the_edited_graph_of_s5(
    tmp_path: Path,
) -> None:
    """Vectors of the subgraph follow the edit, and one-hot codes stay; both for the test only."""
    how = SplitTest(split="S5")
    for agent, follows in (("subgraph", True), ("query-onehot", False)):
        config = experiment_config(f"irb120-choose-{agent}-fast", env=CHOOSE_ENV)
        tested = how.prepare(Subject(env=config.env, config=config))
        table = build(config).knowledge.table
        graph, trained = tested.graph, config.env
        again = config.knows.known(tested.env, 0, graph=graph, trained=trained).table
        assert again.shape == table.shape
        moved = np.abs(again - table).max(axis=1) > 0.01
        assert moved.any() == follows
        assert not moved.all()
    elsewhere = override(config, {"knows": {"graph": "household"}})
    with pytest.raises(UserError, match="trained with knowledge from another one"):
        how.prepare(Subject(env=elsewhere.env, config=elsewhere))


def test_an_evaluation_on_the_edited_graph_counts_the_old_answers(
    choose_run: Run,
) -> None:
    trained = load_agent(choose_run.folder.path)
    network = trained.network
    assert network is not None
    tables = []
    make = trained.with_knowledge
    trained.with_knowledge = lambda known: tables.append(known.table) or make(known)  # type: ignore[method-assign]
    result = evaluate(
        trained, episodes=8, probes=(), test=(SplitTest(split="S5"),), write=False
    )
    assert (tables[0] != network.knowledge.numpy()).any()
    assert (trained.agent.recognition.knowledge == network.knowledge).all()
    wrong = result.episodes["chose_old_answer"]
    assert not (wrong & result.episodes["choice_correct"]).any()
    assert result.summary["chose_old_answer"] == wrong.mean()
    assert result.summary.label == "post-training-greedy-s5"
    with pytest.raises(UserError, match="set split to 'S5'"):
        SplitTest(split="S2", edited="mine.csv")


def test_the_oracle_chooses_and_reaches_in_every_split() -> None:
    for split in ("S1", "S3", "S5"):
        task = AskObject(queries=GraphQueries(pairs="none", split=split))
        env = EnvConfig(task=task, dynamics="kinematic", image_size=8)
        result = evaluate(OracleAgent, env, episodes=40)
        assert result.summary["choice"] >= 0.97
        assert result.summary["success_if_chosen"] >= 0.97


def test_a_split_needs_queries_of_a_graph() -> None:
    env = EnvConfig(task=AskObject(queries=NameQueries()))
    with pytest.raises(UserError, match="no queries that a graph could answer"):
        evaluate(OracleAgent, env, episodes=4, test=(SplitTest(split="S2"),))


def test_questions_follow_a_graph_that_was_edited(tmp_path: Path) -> None:
    graph = tmp_path / "tidy.csv"
    graph.write_bytes(
        (Path(__file__).parents[2] / "examples/own_graph/tidy.csv").read_bytes()
    )
    targets = (
        "mug",
        "teapot",
        "bowl",
        "mallet",
        "toolbox",
        "bucket",
        "lamp",
        "book",
        "clock",
    )
    env = EnvConfig(
        targets=targets,
        task=AskObject(queries=GraphQueries(graph=str(graph), hold_out=())),
    )
    before = questions_of(env)
    assert before is not None
    assert questions_of(env) is before
    stamp = graph.stat().st_mtime_ns + 10**9
    graph.write_text(graph.read_text() + "mug,makes,noise\nclock,makes,noise\n")
    os.utime(graph, ns=(stamp, stamp))
    after = questions_of(env)
    assert after is not None
    names = [{query.name for query in table.queries} for table in (before, after)]
    assert "makes noise" in names[1] - names[0]
