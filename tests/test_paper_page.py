"""The page on the paper's experiment is built from its study, here a tiny one."""

from types import SimpleNamespace

import numpy as np
import pytest

from knowarm.report.collect import collect
from knowarm.study import driver
from knowarm.study.config import read_study
from knowarm.study.driver import run_study
from scripts.build_paper import OUTCOMES, PACK, Course, Sources, main, margin, page
from tests.study.tiny import InlineExecutor

TOML = """
name = "tiny-paper"
experiments = ["irb120-bm-a3c", "irb120-full-a3c"]
seeds = [0]
[overrides]
total_steps = 400
interim = {every_steps = 200, episodes = 2}
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
