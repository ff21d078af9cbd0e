"""Interim evaluations: the evaluated network was trained to the last step, or it is said."""

import logging
import re
from pathlib import Path

import pytest

from knowarm.cli.main import main
from knowarm.experiment.algorithms import algorithms
from knowarm.experiment.csv_log import read_csv
from knowarm.experiment.load import load_agent
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run import train
from knowarm.experiment.run_folder import RunFolder
from knowarm.report.collect import collect
from tests.snippets.test_snippets import PAGES
from tests.thorough import thorough
from tests.tiny import ALGORITHM, flags, short

ROOT = Path(__file__).parents[2]
LEARNING = "docs/results/learning.md"
TOTAL = re.compile(r"total[-_]steps[\s=]+(\d[\d_,]*)")
STEPS = re.compile(r"\b\d{2,3},\d{3}\b")
SCALE, MOST = 1_000, 100
"""Steps of the documentation per step of the test, and most steps of the test."""
SMALL = {
    "ppo": ALGORITHM,
    "distil": ALGORITHM,
    "a3c": {"workers": 1, "rollout_ends_with_episode": False},
}
"""Options of short trainings, by trainer."""


def documented_steps() -> list[int]:
    pages = [
        ROOT / "README.md",
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "docs").rglob("*.ipynb"),
    ]
    found = {number for page in pages for number in TOTAL.findall(page.read_text())}
    return sorted({int(re.sub("[_,]", "", each)) for each in found})


def documented_trainings() -> dict[str, set[int]]:
    """Return the numbers of steps that the documentation names for each algorithm."""
    found: dict[str, set[int]] = {
        name: {entry.total_steps} for name, entry in algorithms().items()
    }
    for page in (*PAGES, LEARNING):
        text = (ROOT / page).read_text()
        lines = text.replace("\\\n", " ").splitlines()
        if page == LEARNING:  # a command in a paragraph
            lines = [part.replace("\n", " ") for part in text.split("\n\n")]
        named = [(line, TOTAL.findall(line)) for line in lines]
        if page.endswith("choose-an-algorithm.md"):  # a table row per algorithm
            named += [
                (row, STEPS.findall(row)) for row in re.findall(r"^\| .*", text, re.M)
            ]
        for line, numbers in named:
            for name in {
                *re.findall(r"(?:-|`)(fast|distil|ppo|a3c-tuned|a3c)\b(?!-)", line)
            }:
                found[name] |= {int(re.sub("[_,]", "", each)) for each in numbers}
    return found


def evaluated(folder: RunFolder) -> list[int]:
    return [int(row["step"]) for row in read_csv(folder.evaluations_path)]


def test_every_training_of_the_docs_has_ten_evaluations():
    assert {24_000, 80_000, 500_000, 2_000_000} <= {*documented_steps()}
    for algorithm, entry in algorithms().items():
        if entry.needs_grounding:
            continue
        for steps in (*documented_steps(), entry.total_steps):
            config = experiment_config(f"irb120-full-{algorithm}", total_steps=steps)
            assert 10 * config.evaluate_every <= steps
            assert config.evaluate_every <= config.interim.every_steps


@pytest.mark.parametrize("algorithm", SMALL)
def test_the_network_of_the_last_step_is_evaluated_once(tmp_path, algorithm):
    options = {"total_steps": 110, "interim": {"every_steps": 100, "episodes": 2}}
    name = f"irb120-full-{algorithm}"
    run = train(name, tmp_path, algorithm=SMALL[algorithm], **options)
    steps = evaluated(run.folder)
    assert steps[0] == 0
    assert steps[-1] == run.result.step >= 110
    again = train(name, tmp_path, resume=True, algorithm=SMALL[algorithm], **options)
    assert again.result == run.result
    assert evaluated(run.folder) == steps
    options["total_steps"] = 150
    more = train(name, tmp_path, resume=True, algorithm=SMALL[algorithm], **options)
    assert evaluated(run.folder)[-1] == more.result.step >= 150


@pytest.mark.parametrize(
    "algorithm",
    [name for name, entry in algorithms().items() if not entry.needs_grounding],
)
def test_documented_trainings_are_evaluated_with_their_best_network(
    tmp_path, algorithm, capsys, monkeypatch
):
    """Steps are scaled down. An earlier network is taken if it was better only.

    The last interval between evaluations is half as long as the others, so that the network of the
    last step is evaluated only if training does so at its end.
    """
    monkeypatch.setattr("knowarm.experiment.config.MIN_EVALUATIONS", 1)
    numbers = documented_trainings()
    assert {24_000, 80_000, 200_000} <= numbers["distil"]
    assert 500_000 in numbers["fast"]
    trainer = experiment_config(f"irb120-bm-{algorithm}").algorithm.name
    scaled = {min(each // SCALE, MOST) for each in numbers[algorithm]}
    for steps in sorted(thorough({min(scaled), max(scaled)}, scaled)):
        every = steps * 2 // 3
        short = {"total_steps": steps, "interim": {"every_steps": every, "episodes": 2}}
        updates = SMALL[trainer] | {"rollout_steps": 2}  # of at most eight steps
        updates |= (
            {"envs_per_worker": 1 if algorithm == "a3c" else 4}
            if trainer == "a3c"
            else {}
        )
        options = {**short, "algorithm": updates, "runs": tmp_path / str(steps)}
        name = f"irb120-bm-{algorithm}"
        assert main(["train", name, *flags(options)]) == 0
        printed = capsys.readouterr().out
        folder = RunFolder(tmp_path / str(steps) / name / "0")
        rows = read_csv(folder.evaluations_path)
        last, agent = int(rows[-1]["step"]), load_agent(folder.path)
        assert steps <= last < 2 * every
        assert f"Trained for {last:,} steps" in printed
        assert f"at step {agent.step:,}\n" in printed
        best = max(rows, key=lambda row: float(row["return_mean"]))
        assert agent.step == int(best["step"])
        assert agent.step > 0 or "untrained network" in printed


def test_a_run_that_ended_without_a_last_evaluation_gets_it_on_resuming(
    tmp_path, monkeypatch
):
    config = short(total_steps=100)
    with monkeypatch.context() as old:
        old.setattr("knowarm.learn.trainer.Trainer.lacks_evaluation", False)
        old.setattr("knowarm.experiment.config.MIN_EVALUATIONS", 1)
        run = train(config, tmp_path)
    assert evaluated(run.folder) == [80]
    (run.folder.path / "evaluation" / "default").mkdir(parents=True)
    train(config, tmp_path, resume=True)
    assert evaluated(run.folder) == [80, 100]
    assert (run.folder.path / "evaluation-at-100").is_dir()


def test_an_untrained_network_is_never_preferred_in_silence(tmp_path, capsys, caplog):
    # No step changes a weight, and no evaluation the return
    rate = {"learning_rate": 1e-12}
    settings = {
        "total_steps": 40,
        "interim": {"episodes": 2},
        "algorithm": ALGORITHM | rate,
    }
    arguments = [
        "irb120-full-ppo",
        "--runs",
        str(tmp_path / "my runs"),
        *flags(settings),
    ]
    assert main(["train", *arguments]) == 0
    printed = capsys.readouterr().out
    assert "success 0 %, return" in printed
    assert f"knowarm report '{tmp_path / 'my runs'}'" in printed
    assert "at step 0\nThat is the untrained network" in printed
    path = tmp_path / "my runs" / "irb120-full-ppo" / "0"
    assert f"knowarm evaluate '{path}'" in printed
    with caplog.at_level(logging.WARNING, "knowarm.experiment"):
        load_agent(path)
    (record,) = caplog.records
    assert "this network is untrained" in record.getMessage()
    assert "'latest' was trained for 40 steps" in record.getMessage()
    caplog.clear()
    load_agent(path, which="latest")
    load_agent(path, which="untrained")
    assert not caplog.records
    played = ["evaluate", str(path), "--episodes", "2", "--blind-episodes", "0"]
    assert main(played) == 0
    said = [problem.what for problem in collect([path]).problems]
    assert "its best interim evaluation is that of step 0" in said
