"""Tests of ``benchmarks/learn.py`` with tiny sizes."""

from dataclasses import replace

import pytest

from benchmarks.learn import LearnBenchConfig, bench_learn, in_turns
from benchmarks.time_to_success import with_algorithm
from knowarm.errors import UserError
from knowarm.experiment.names import experiment_config


@pytest.mark.slow
def test_all_learners_are_in_one_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.learn.A3C_WORKERS", 2)
    full = LearnBenchConfig.ppo
    monkeypatch.setattr(
        LearnBenchConfig,
        "ppo",
        lambda *names: replace(full(*names), num_envs=8, minibatches=2),
    )
    result = bench_learn(LearnBenchConfig(cores=1, seconds=0.1, turns=1))
    rows = {row["name"]: row for row in result["rows"]}
    assert set(rows) == {"raycaster", "fast", "ppo", "distil", "a3c", "a3c-batched"}
    assert all(row["steps_per_s"] > 0 for row in rows.values())
    assert result["steps_per_s"] == rows["ppo"]["steps_per_s"]
    ratio = rows["a3c-batched"]["steps_per_s"] / rows["a3c"]["steps_per_s"]
    assert result["ratio_a3c_batched"] == ratio
    shares = [value for name, value in rows["ppo"].items() if name.startswith("share")]
    assert len(shares) == 4
    assert all(share > 0 for share in shares)
    assert sum(shares) <= 1.05


def test_agents_with_a_network_beside_the_policy_are_refused() -> None:
    config = LearnBenchConfig(experiment="irb120-choose-subgraph-ppo")
    with pytest.raises(UserError, match="choose an agent without one"):
        bench_learn(config)


def test_configurations_take_turns_and_the_median_counts() -> None:
    speeds = iter([1.0, 5.0, 3.0, 4.0, 2.0, 9.0])
    measures = [
        lambda name=name: {"name": name, "steps_per_s": next(speeds)} for name in "ab"
    ]
    assert in_turns(measures, 3) == [
        {"name": "a", "steps_per_s": 2.0},
        {"name": "b", "steps_per_s": 5.0},
    ]


def test_sizes_out_of_range_are_refused() -> None:
    with pytest.raises(UserError, match="cores must be at least 1, got 0"):
        LearnBenchConfig(cores=0)


def test_another_algorithm_is_measured_on_the_same_task():
    chosen = with_algorithm(experiment_config("irb120-choose-bm-fast"), "ppo")
    assert chosen.name == "irb120-choose-bm-ppo"
