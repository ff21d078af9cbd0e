"""Studies whose truth is known: the report finds what is there, and nothing else."""

from pathlib import Path

import numpy as np
import pytest
from synthetic_study import Size, Truth, write_study

from knowarm.report.claims import claims, scores
from knowarm.report.collect import collect
from knowarm.report.verdict import Finding, finding
from knowarm.statistics import holm, welch

LIGHT = Size(points=12, tables=False)

AGENTS = ("bm", "full", "wide", "zeros", "random", "shuffled", "onehot")
REAL = dict.fromkeys(AGENTS, 0.5) | {"full": 0.75}
CAPACITY = dict.fromkeys(AGENTS, 0.75) | {"bm": 0.5}
NOTHING = dict.fromkeys(("bm", "full", "wide", "random"), 0.6)


def found(
    folder: Path, success: dict[str, float], seeds: int, seed: int = 0, spread: float = 0.05
) -> dict[str, Finding]:
    truth = Truth(success=success, spread=spread)
    study = collect(write_study(folder, truth, seeds=seeds, seed=seed, size=LIGHT))
    decided = claims(study)
    return {name: finding(study.tasks[0], decided, name) for name in ("success", "speed")}


@pytest.mark.parametrize("seed", range(3))
def test_a_real_effect_is_found(tmp_path, seed):
    assert found(tmp_path, REAL, 6, seed)["success"].kind == "knowledge matters"


@pytest.mark.parametrize("seed", range(3))
def test_an_effect_of_size_alone_is_not_taken_for_knowledge(tmp_path, seed):
    result = found(tmp_path, CAPACITY, 6, seed)["success"]
    assert result.kind == "size may explain it"
    assert "wide" in result.sentence


def test_an_effect_of_any_input_is_not_taken_for_meaning(tmp_path):
    truth = dict.fromkeys(AGENTS, 0.75) | dict.fromkeys(("bm", "wide", "zeros"), 0.5)
    assert found(tmp_path, truth, 6)["success"].kind == "input without meaning"


def test_harm_is_called_harm(tmp_path):
    truth = dict.fromkeys(AGENTS, 0.75) | {"full": 0.4}
    assert found(tmp_path, truth, 6)["success"].kind == "worse"


def test_nothing_is_claimed_where_there_is_nothing(tmp_path):
    assert found(tmp_path, NOTHING, 6)["success"].kind == "no advantage"


@pytest.mark.parametrize("seeds", [1, 2])
def test_few_seeds_allow_no_claim_however_large_the_difference(tmp_path, seeds):
    truth = dict.fromkeys(AGENTS, 0.1) | {"full": 0.95}
    result = found(tmp_path, truth, seeds, spread=0.001)["success"]
    assert result.kind == "too few seeds"
    assert "cannot be decided" in result.sentence


@pytest.mark.parametrize(
    ("agents", "kind"),
    [
        (("bm", "full"), "size not excluded"),
        (("bm", "full", "wide", "zeros"), "meaning not tested"),
        (("full", "wide"), "no baseline"),
        (("bm", "wide"), "nothing to compare"),
        (("full",), "nothing to compare"),
    ],
)
def test_a_verdict_names_the_control_that_is_missing(tmp_path, agents, kind):
    truth = {agent: REAL[agent] for agent in agents}
    assert found(tmp_path, truth, 6)["success"].kind == kind


def test_a_claim_behind_a_closed_gate_is_not_tested(tmp_path):
    # full beats zeros by far, but not the baseline.
    truth = dict.fromkeys(AGENTS, 0.7) | {"zeros": 0.1}
    paths = write_study(tmp_path, Truth(success=truth), seeds=6, size=LIGHT)
    decided = claims(collect(paths))
    zeros = next(c for c in decided if c.second.agent == "zeros" and c.outcome == "success")
    assert zeros.comparison.p_value < 1e-4
    assert zeros.verdict == "not tested"


def test_an_adjusted_p_is_never_below_the_plain_one(tmp_path):
    paths = write_study(tmp_path, Truth(success=REAL), seeds=5, size=LIGHT)
    for claim in claims(collect(paths)):
        if claim.adjusted_p is not None:
            assert claim.adjusted_p >= claim.comparison.p_value
            if claim.verdict in ("better", "worse"):
                interval = claim.comparison.difference
                assert interval.low > 0 or interval.high < 0


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [3, 5])
def test_without_any_effect_at_most_one_study_in_twenty_claims_one(tmp_path, seeds):
    quiet = {"no advantage", "too few seeds"}
    loud = 0
    for number in range(200):
        results = found(tmp_path / str(number), NOTHING, seeds, seed=1_000 * seeds + number)
        loud += any(each.kind not in quiet for each in results.values())
    assert loud <= 10


@pytest.mark.slow
def test_the_promise_holds_over_many_tasks_and_many_studies():
    """The same rule on bare scores, often enough to measure its rate."""
    generator = np.random.default_rng(0)
    loud = 0
    for _ in range(2_000):
        gates = [
            welch(generator.normal(0.6, 0.05, 5), generator.normal(0.6, 0.05, 5)).p_value
            for _ in range(8)  # four tasks, two outcomes
        ]
        loud += bool((holm(gates) <= 0.05).any())
    assert loud / 2_000 <= 0.06


def test_curves_are_compared_as_far_as_every_agent_has_a_run(tmp_path):
    paths = write_study(tmp_path, Truth(success={"bm": 0.5, "full": 0.5}), seeds=2, size=LIGHT)
    for path in (paths[0], paths[2], paths[3]):  # one run of bm stopped, both of full
        for name in ("evaluations.csv", "metrics.csv"):
            lines = (path / name).read_text().splitlines(keepends=True)
            (path / name).write_text("".join(lines[:7]))
    task = collect(paths).tasks[0]
    assert task.horizon == 2_000_000
    bm, full = task.groups
    long, short = bm.runs[1], full.runs[0]
    assert long.interim["step"][-1] == 4_000_000
    early = long.interim["success"][long.interim["step"] <= 2_000_000]
    assert scores(task, bm, "speed")[1] <= early.max()
    assert scores(task, full, "speed")[0] <= short.interim["success"].max()
