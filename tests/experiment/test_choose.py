"""Experiments of the choice task: names, training, evaluation and its splits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from knowarm.config import from_dict, to_dict
from knowarm.errors import UserError
from knowarm.experiment.agents import AGENTS
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.experiment.build import build, load_agent
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.graph_queries import GraphQueries, retold
from knowarm.experiment.registry import experiment_config, experiment_names
from knowarm.experiment.run import train
from knowarm.world.agents import OracleAgent
from knowarm.world.config import choice_env_config

TINY = {"images": 64, "rounds": 1, "batch": 32}
SMALL = {"dynamics": "kinematic", "choice": {"queries": {"pairs": "none"}}}


def test_names_say_task_and_agent() -> None:
    names = [name for name in experiment_names() if "-choose-" in name]
    assert "irb120-choose-mask-fast" in names
    assert "tiago-choose-bm-ppo" in names
    assert not [name for name in names if "-near-" in name or "-full-" in name]
    with pytest.raises(UserError, match="Unknown agent of the experiment 'fulll'"):
        experiment_config("irb120-choose-fulll-fast")


def test_the_image_marks_the_object_for_the_upper_bound_only() -> None:
    for name, agent in AGENTS.items():
        if f"irb120-choose-{name}-fast" in experiment_names():
            config = experiment_config(f"irb120-choose-{name}-fast")
            assert config.env.choice is not None
            assert config.env.choice.marked == agent.marked == (name == "mask")


def test_a_config_survives_json() -> None:
    config = experiment_config("irb120-choose-subgraph-fast", env=SMALL)
    assert from_dict(ExperimentConfig, to_dict(config), where="config") == config
    assert isinstance(config.env.choice.queries, GraphQueries)  # type: ignore[union-attr]


def test_the_knowledge_table_has_a_row_per_query() -> None:
    told = build(experiment_config("irb120-choose-query-onehot-fast", env=SMALL))
    nothing = build(experiment_config("irb120-choose-bm-fast", env=SMALL))
    assert told.table.shape == (49, 50)
    assert nothing.table.shape == (49, 0)
    assert len(np.unique(told.table, axis=0)) == 49


def test_an_algorithm_may_have_other_settings_in_the_choice_task(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    choice = {"total_steps": 7, "algorithm": {"gamma": 0.5}}
    monkeypatch.setitem(ALGORITHMS, "fast", replace(ALGORITHMS["fast"], choice=choice))
    reach, choose = (experiment_config(f"irb120-{name}-fast") for name in ("bm", "choose-bm"))
    assert (choose.total_steps, choose.algorithm) == (7, replace(reach.algorithm, gamma=0.5))
    assert reach.total_steps == ALGORITHMS["fast"].total_steps


def test_training_and_evaluation_report_the_choice(tmp_path: Path) -> None:
    run = train(
        "irb120-choose-query-onehot-fast",
        tmp_path,
        total_steps=400,
        grounding=TINY,
        env=SMALL,
        algorithm={"num_envs": 8, "rollout_steps": 25, "minibatches": 2, "processes": 1},
        interim={"every_steps": 400, "episodes": 4},
    )
    header = (run.folder.path / "evaluations.csv").read_text().splitlines()[0]
    assert "choice" in header.split(",")
    result = evaluate(run.folder.path, episodes=8, blind_episodes=0, split="S2")
    folder = result.write()
    assert folder.name == "post-training-greedy-s2"
    assert result.summary["choice_chance"] == 0.25
    assert {"query", "chosen", "choice_correct"} <= result.episodes.keys()
    assert result.summary["per_query"]


def test_the_edited_graph_of_s5_is_told_to_the_policy(tmp_path: Path) -> None:
    """Vectors of the subgraph follow the edit, and one-hot codes stay; both for the test only."""
    for agent, follows in (("subgraph", True), ("query-onehot", False)):
        config = experiment_config(f"irb120-choose-{agent}-fast", env=SMALL)
        judged = replace(config.env.choice, queries=GraphQueries(pairs="none", split="S5"))
        table = build(config).table
        again = retold(config, replace(config.env, choice=judged))
        assert again.shape == table.shape
        moved = np.abs(again - table).max(axis=1) > 0.01
        assert moved.any() == follows
        assert not moved.all()
    elsewhere = replace(config, knowledge=replace(config.knowledge, graph="household"))
    with pytest.raises(UserError, match="told about them from household"):
        retold(elsewhere, replace(config.env, choice=judged))


def test_an_evaluation_on_the_edited_graph_counts_the_old_answers(tmp_path: Path) -> None:
    run = train(
        "irb120-choose-subgraph-fast",
        tmp_path,
        total_steps=200,
        grounding=TINY,
        env=SMALL,
        algorithm={"num_envs": 8, "rollout_steps": 25, "minibatches": 2, "processes": 1},
        interim={"every_steps": 200, "episodes": 4},
    )
    trained = load_agent(run.folder.path)
    network = trained.agent.perception  # type: ignore[attr-defined]
    before = network.knowledge.clone()
    seen = []
    found = network.found
    network.found = lambda *images: seen.append(network.knowledge.clone()) or found(*images)
    result = evaluate(trained, episodes=8, blind_episodes=0, split="S5")
    assert (network.knowledge == before).all()
    assert all((table != before).any() for table in seen)
    assert seen
    wrong = result.episodes["chose_old_answer"]
    assert not (wrong & result.episodes["choice_correct"]).any()
    assert result.summary["chose_old_answer"] == wrong.mean()
    assert result.write().name == "post-training-greedy-s5"
    with pytest.raises(UserError, match="set split to 'S5'"):
        evaluate(trained, episodes=8, split="S2", edited="mine.csv")


def test_the_oracle_chooses_and_reaches_in_every_split() -> None:
    env = choice_env_config(dynamics="kinematic", image_size=8)
    assert env.choice is not None
    for split in ("S1", "S3", "S5"):
        choice = replace(env.choice, queries=GraphQueries(pairs="none", split=split))
        result = evaluate(OracleAgent(), replace(env, choice=choice), episodes=40)
        assert result.summary["choice"] >= 0.97
        assert result.summary["success_if_chosen"] >= 0.97


def test_a_split_needs_queries_of_a_graph() -> None:
    with pytest.raises(UserError, match="this task asks none"):
        evaluate(OracleAgent(), choice_env_config(), episodes=4, split="S2")
