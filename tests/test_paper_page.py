"""The page on the paper's experiment is built from its study, here a tiny one."""

from types import SimpleNamespace

import numpy as np
import pytest

from knowarm.report.collect import collect
from knowarm.study import driver
from knowarm.study.config import read_study
from knowarm.study.driver import run_study
from scripts.build_paper import OUTCOMES, PACK, Sources, main, margin, page
from scripts.paper_courses import (
    ARMS,
    Course,
    arms_part,
    schedules_part,
)
from tests.study.tiny import InlineExecutor

TOML = """
name = "tiny-paper"
experiments = ["irb120-bm-a3c", "irb120-full-a3c"]
seeds = [0]
[overrides]
total_steps = 400
interim = {every_steps = 200, episodes = 2}
policy = {features = 16, hidden = 16}
algorithm.workers = 2
[[evaluations]]
episodes = 6
probes = [{ kind = "steps" }, { kind = "films", episodes = 1 }, { kind = "blind", episodes = 4 }]
[[evaluations]]
label = "distance"
angle_deg = 180
episodes = 6
probes = [{ kind = "blind", episodes = 6 }]
[[evaluations]]
label = "strict"
distance_m = 0.05
angle_deg = 15
episodes = 6
probes = [{ kind = "blind", episodes = 6 }]
[[evaluations]]
label = "anova"
episodes = 12
seeds = 6
probes = []
"""


@pytest.mark.slow(40)
def test_the_page_shows_every_cell_beside_the_papers_figures(
    tmp_path, monkeypatch, no_search
):
    out, images = tmp_path / "study", tmp_path / "images"
    images.mkdir()
    monkeypatch.setattr(driver, "make_executor", InlineExecutor)
    (tmp_path / "study.toml").write_text(TOML)
    run_study(read_study(tmp_path / "study.toml"), out)
    with Sources.read(out) as sources:
        text = page(sources, images)
    for agent, accuracy in (("bm", 80), ("full", 92)):  # the paper's, section 5.2
        assert f"| IRB120, fixed colours | `{agent}` | {accuracy} | 0.0 M | " in text
    for agent, accuracy in (("bm", 63), ("partial", 62), ("full", 79)):
        cells = f"| TIAGo, randomized colours | `{agent}` | {accuracy} | not begun | "
        assert cells in text
    # results, outcomes, F value, six joints
    assert text.count("| IRB120, fixed colours | ") == 3 + 2 + 1 + 6
    (run, _) = collect([out]).tasks[0].runs
    distance = run.evaluations["distance"].summary
    assert distance["success"] == distance["accuracy"], "an episode ends within 10 cm"
    accuracy = run.evaluations["post-training-greedy"].summary["accuracy"]
    listed = distance.interval("success", "blind", "open-loop").estimate
    primary = margin(run, *next(iter(OUTCOMES.values())))
    assert primary.estimate == pytest.approx(accuracy - listed)
    assert "| 150.9 |" in text  # the paper's F value, section 5.3
    assert "of its twelve cells two are complete." in text
    assert "joint 6" in (images / "paper-joints.svg").read_text()
    assert "full" in (images / "paper-curves.svg").read_text()
    assert (images / "paper-strips.png").stat().st_size > 1000


def test_the_largest_fall_is_that_from_the_highest_mean_before():
    returns = np.repeat([0.0, 10.0, 4.0, 12.0, 9.0, 20.0], 20)
    steps = 50_000 * np.arange(1, len(returns) + 1)
    run = SimpleNamespace(interim={"return_mean": returns, "step": steps})
    fallen, before, after = Course.of(run).fall
    assert (fallen, before, after) == (pytest.approx(6), 2e6, 3e6)
    few = {"return_mean": returns[:19], "step": steps[:19]}
    assert Course.of(SimpleNamespace(interim=few)) is None


def course_run(returns, every, total, name="run"):
    """A run with interim evaluations of these returns, that succeed where they are positive."""
    steps = every * np.arange(1, len(returns) + 1)
    returns = np.array(returns, float)
    rate = (returns > 0).astype(float)
    interim = {"step": steps, "return_mean": returns, "success": rate, "accuracy": rate}
    metrics = {"step": steps, "wall_time_s": steps / 100.0}
    blind = SimpleNamespace(interval=lambda *names: SimpleNamespace(estimate=0.325))
    return SimpleNamespace(
        path=name,
        interim=interim,
        metrics=metrics,
        steps_done=float(steps[-1]),
        config=SimpleNamespace(total_steps=total),
        evaluations={"trained": SimpleNamespace(summary=blind)},
    )


def study_of(*runs):
    group = SimpleNamespace(label="trained", runs=runs)
    return SimpleNamespace(tasks=[SimpleNamespace(runs=list(runs), groups=[group])])


def test_arms_are_compared_over_the_same_last_steps_and_only_when_complete():
    constant = course_run([10.0] * 25 + [-5.0] * 5 + [99.0] * 30, 1_000_000, 70_000_000)
    arm = course_run([-10.0] * 20 + [10.0] * 10, 1_000_000, 30_000_000)
    arms = {name: study_of(arm) for name in ARMS}
    _, lead, text, rows = arms_part(constant, arms)
    assert "up to 30 million steps" in text.replace("\n", " ")
    assert "the best list of actions reaches 32.5 %" in text
    cells = {
        row.split(" | ")[0].strip("| "): row.split(" | ")[1:]
        for row in rows.splitlines()
    }
    assert lead.startswith(
        "**With a rate falling to 0 100 % succeed, with the paper's numbers 0 %"
    )
    assert lead.endswith("falls by up to 0, with the constant one by up to 4.")
    # Running means of 20: 10 at 20 M, then the five falls, (15 * 10 - 5 * 5) / 20 = 6.25 at 30 M.
    assert cells["the paper's"][:3] == ["-5", "0.0", "0.0"]
    assert cells["the paper's"][4].startswith("4, ")
    assert "to 30.0 M" in cells["the paper's"][4]
    assert cells["a rate falling to 0"][:3] == ["+10", "100.0", "100.0"]
    assert cells["a rate falling to 0"][4].startswith("0, ")
    begun = course_run([-10.0] * 30, 900_000, 30_000_000)
    assert arms_part(constant, {**arms, "paper-a3c-decay": study_of(begun)}) == []
    assert arms_part(constant, {"paper-a3c-decay": study_of(arm)}) == []


def test_schedules_are_compared_by_seeds_and_only_when_complete():
    fixed = [
        course_run([0.0] * 30 + [level] * 10, 50_000, 2_000_000) for level in (1, 2, 3)
    ]
    other = [
        course_run([0.0] * 30 + [level] * 10, 50_000, 2_000_000) for level in (5, 6, 7)
    ]
    _, text, rows = schedules_part(study_of(*fixed), study_of(*other))
    assert text.startswith(
        "**What is learned differs: return, return, all steps.** The same cell, the first 2 of 70"
    )
    assert "3\ntraining seeds" in text
    # Welch's t of two times three values one apart: 4 +- 2.776 * sqrt(2 / 3).
    assert "| return | 2.0 | 6.0 | +4.0 [+1.7, +6.3] |" in rows
    assert "| return, all steps | 0.5 | 1.5 | +1.0 [+0.4, +1.6] |" in rows
    assert "| steps per second | 100 | 100 | " in rows
    failed = [course_run([-level] * 40, 50_000, 2_000_000) for level in (1, 2, 3)]
    _, text, _ = schedules_part(study_of(*failed), study_of(*failed))
    assert text.startswith(
        "**No difference of what is learned is shown, and no late episode succeeds.**"
    )
    begun = course_run([0.0] * 30, 50_000, 2_000_000)
    assert schedules_part(study_of(*fixed[:2], begun), study_of(*other)) == []
    assert schedules_part(study_of(*fixed), study_of(*other[:2])) == []


@pytest.mark.slow(30)
def test_the_committed_page_is_what_the_packs_say(tmp_path, monkeypatch):
    out = tmp_path / "paper.md"
    command = ["build_paper", "--out", str(out), "--images", str(tmp_path)]
    monkeypatch.setattr("sys.argv", command)
    main()
    assert out.read_text("utf-8") == PACK.with_name("paper.md").read_text("utf-8")
    images = PACK.parents[1] / "images"
    for file in tmp_path.glob("paper-*"):
        if file.suffix == ".svg":
            assert file.read_bytes() == (images / file.name).read_bytes()
