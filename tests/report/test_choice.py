"""The page "Was the query understood?" on studies whose truth is known, and on a real run."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from knowarm.experiment.agents import AGENTS
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.evaluation import SplitTest
from knowarm.experiment.probes import FilmsProbe
from knowarm.experiment.summary import EPISODE_COLUMNS, episode_types, write_table
from knowarm.reading import read_json, write_json
from knowarm.report import write_report
from knowarm.report.blocks import DataTable, flat
from knowarm.report.charts import TEMPLATES
from knowarm.report.collect import collect
from knowarm.report.model import StudyData
from knowarm.report.pages import behaviour
from knowarm.report.pages.results import result_blocks
from knowarm.report.verdicts.claims import Finding
from knowarm.report.verdicts.knowledge import answer
from knowarm.report.verdicts.query import query_findings
from knowarm.report.write import build_pages
from tests.report.synthetic_study import Size, choice_env, write_choice, write_run

LIGHT = Size(points=8, episodes=400, tables=False)
CONTROLS = ("bm", "query-zeros", "query-onehot", "query-random", "subgraph-shuffled")
EVERY = dict.fromkeys(CONTROLS, 0.3) | {
    "bm": 0.25,
    "query-zeros": 0.25,
    "subgraph": 0.9,
}


def study_of(
    folder: Path,
    choices: dict[str, dict[str, float]],
    *,
    seeds: int = 3,
    size: Size = LIGHT,
    reach: float = 0.8,
    old: float = 0.5,
) -> StudyData:
    """Collect a study in which each agent chooses rightly with a probability per split."""
    generator = np.random.default_rng(0)
    paths = []
    for agent, splits in choices.items():
        for seed in range(seeds):
            path = folder / f"irb120-choose-{agent}-fast" / str(seed)
            env = choice_env(marked=agent == "mask")
            write_run(path, agent, seed, 0.5, env=env, generator=generator, size=size)
            shutil.rmtree(path / "evaluation")  # of a task that does not ask
            for split, choice in splits.items():
                share = float(np.clip(generator.normal(choice, 0.02), 0.02, 0.98))
                where = path / "evaluation" / f"post-training-greedy-{split.lower()}"
                write_choice(
                    where,
                    agent,
                    split,
                    share,
                    generator,
                    reach=reach,
                    old=old,
                    size=size,
                )
            paths.append(path)
    return collect(paths)


def on(split: str, choices: dict[str, float]) -> dict[str, dict[str, float]]:
    return {agent: {split: choice} for agent, choice in choices.items()}


def only(study: StudyData) -> Finding:
    (finding,) = query_findings(study)
    return finding


def named(sentence: str) -> set[str]:
    """Agents that a sentence names."""
    words = sentence.split(": ", 1)[1].replace(",", " ").replace(".", " ").split()
    return set(words) & set(AGENTS)


def some(*agents: str, **others: float) -> dict[str, float]:
    return {name: EVERY[name] for name in agents} | others


@pytest.mark.parametrize(
    ("split", "choices", "kind", "words"),
    [
        (
            "S2",
            EVERY,
            "understood",
            "S2 (pairs of condition and object that training never asked)",
        ),
        # A code that is as good refutes the meaning.
        (
            "S1",
            EVERY | {"query-onehot": 0.9},
            "not above the best control",
            "not significantly more often than query-onehot",
        ),
        ("S1", some("bm", "query-onehot", "subgraph"), "understood", ""),
        # The meaning is tested by content controls only.
        (
            "S1",
            some("bm", "query-zeros", "subgraph"),
            "meaning not tested",
            "Registered for this: query-onehot",
        ),
        ("S1", {"subgraph": 0.9, "mask": 0.99}, "no control", ""),
        # On S5 a code follows the old graph, and so lies below chance.
        (
            "S5",
            dict.fromkeys(CONTROLS, 0.05) | {"subgraph": 0.25},
            "not above chance",
            "",
        ),
    ],
)
def test_a_query_is_understood_if_every_control_is_beaten(
    tmp_path, split, choices, kind, words
):
    finding = only(study_of(tmp_path, on(split, choices)))
    verdict = finding.verdict()
    assert finding.kind == kind
    assert (verdict.tone == "good") == (kind == "understood")
    assert words in verdict.sentence
    controls = [claim.against for claim in finding.claims if claim.second]
    assert set(controls) == set(choices) & set(CONTROLS)
    notes = 1 + (kind == "understood" and split != "S1")
    assert len(verdict.reasons) == (notes + len(controls) + 1 if controls else 0)
    if kind == "understood":
        assert named(verdict.sentence) == set(choices)
    if kind == "not above the best control":
        assert controls[0] == "query-onehot"
        assert "better than query-random, subgraph-shuffled" in verdict.sentence


@pytest.mark.parametrize("seeds", [1, 2])
def test_few_seeds_decide_nothing(tmp_path, seeds):
    finding = only(study_of(tmp_path, on("S1", EVERY), seeds=seeds))
    assert finding.kind == "too few seeds"
    assert f"{seeds} training seed" in finding.verdict().sentence


def test_unseen_objects_fail_beside_splits_that_are_understood(tmp_path):
    choices = {
        agent: {"S1": choice, "S3": 0.2 if agent == "subgraph" else 0.25}
        for agent, choice in EVERY.items()
    }
    findings = query_findings(study_of(tmp_path, choices))
    assert [(f.outcome, f.kind) for f in findings] == [
        ("S1", "understood"),
        ("S3", "not above chance"),
    ]
    assert answer(findings, 1).sentence.endswith(
        "subgraph: on S1 the query is understood; on S3 choices are not above chance."
    )


def test_controls_are_those_of_the_registry(tmp_path):
    """A shuffled graph is no control of an agent that does not read the graph."""
    choices = {
        "bm": 0.25,
        "query-words": 0.6,
        "subgraph-shuffled": 0.9,
        "query-onehot": 0.3,
    }
    finding = only(study_of(tmp_path, on("S4", choices)))
    assert {claim.against for claim in finding.claims if claim.second} == {
        "bm",
        "query-onehot",
    }
    assert finding.kind == "understood"


VALUES = tuple(f"usedFor {name}" for name in ("a", "b", "c", "d", "e", "f"))
HALF = dict(zip(VALUES, (0.9, 0.3) * 3, strict=True))
"""Right choices by value: 90 % on half of them, on the others no more than controls."""


def write_episodes(study: Path, of_subgraph: dict[str, float]) -> None:
    """Write episodes of six values for every evaluation: controls are right in 30 % of each."""
    generator = np.random.default_rng(5)
    for folder in sorted(study.glob("*/*/evaluation/*")):
        shares = dict.fromkeys(VALUES, 0.3)
        if "choose-subgraph-fast" in str(folder):
            shares = of_subgraph
        count = LIGHT.episodes
        asked = generator.choice(VALUES, count)
        columns = {name: np.zeros(count) for name in EPISODE_COLUMNS}
        columns |= {
            "target": np.full(count, "mug"),
            "facet": np.full(count, "mug/red"),
            "query": np.char.add(asked, " and hasColor red"),
            "choice_correct": [
                generator.random() < shares[value] for value in asked.tolist()
            ],
        }
        columns = {name: np.asarray(values) for name, values in columns.items()}
        types = episode_types(columns, {})
        write_table(folder / "episodes.parquet", columns, types)


@pytest.mark.parametrize(
    ("split", "of_subgraph", "kind", "note"),
    [
        (
            "S4",
            dict.fromkeys(VALUES, 0.9),
            "understood",
            "values that were drawn (6): +",
        ),
        ("S4", HALF, "understood of these", "values that were drawn (6): +"),
        ("S2", HALF, "understood of these", "queries that were drawn (6)"),
        # Of one object nothing follows for others.
        ("S3", HALF, "understood of these", "objects that were drawn (1)"),
        # Training asked the same.
        ("S1", HALF, "understood", ""),
    ],
)
def test_of_other_questions_than_those_drawn_it_is_shown_by_their_spread(
    tmp_path, split, of_subgraph, kind, note
):
    study = study_of(tmp_path, on(split, EVERY))
    write_episodes(tmp_path, of_subgraph)
    finding = only(study)
    assert finding.kind == kind
    assert note in " ".join(finding.notes)
    assert ("it is not shown" in finding.sentence) == (kind == "understood of these")
    assert len(finding.notes) == (1 if split == "S1" else 2)


def test_without_episodes_nothing_is_said_of_other_questions(tmp_path):
    finding = only(study_of(tmp_path, on("S4", EVERY)))
    assert finding.kind == "understood"
    assert "Of other values nothing is known" in finding.notes[-1]


def test_noise_is_hardly_ever_understood(tmp_path):
    loud = 0
    for number in range(8):
        generator = np.random.default_rng(number)
        choices = {
            agent: {
                split: 0.5 + generator.normal(0, 0.02) for split in ("S1", "S2", "S3")
            }
            for agent in ("bm", "query-onehot", "subgraph")
        }
        findings = query_findings(study_of(tmp_path / str(number), choices))
        loud += any(each.kind == "understood" for each in findings)
    assert loud <= 1


def test_numbers_are_corrected_for_chance(tmp_path):
    study = study_of(tmp_path, on("S1", {"bm": 0.25, "subgraph": 0.95}), reach=0.9)
    bm, told = study.tasks[0].splits["S1"]
    assert told.level("choice_corrected").estimate == pytest.approx(
        (told.level("choice").estimate - 0.25) / 0.75
    )
    assert abs(bm.level("success_corrected").estimate) < 0.05
    assert told.level("success_corrected").estimate > 0.75
    assert bm.level("success").estimate > 0.2


def test_the_rate_of_switching_counts_the_new_among_both_answers(tmp_path):
    study = study_of(tmp_path, on("S5", {"subgraph": 0.6}), seeds=1, old=1.0)
    (asked,) = study.tasks[0].splits["S5"]
    assert asked.level("switched").estimate == pytest.approx(
        asked.level("choice").estimate
    )
    never = study_of(tmp_path / "never", on("S5", {"subgraph": 0.6}), seeds=1, old=0.0)
    (asked,) = never.tasks[0].splits["S5"]
    assert asked.level("switched").estimate == 1


def test_the_upper_bound_is_shown_in_the_same_task(tmp_path):
    study = study_of(tmp_path, on("S1", EVERY | {"mask": 0.99}))
    (task,) = study.tasks
    assert "mask" in {each.name for each in task.splits["S1"]}
    assert [group.name for group in task.subjects] == ["subgraph"]
    assert "choose among 4" in task.title
    assert only(study).kind == "understood"


def test_a_study_that_asks_nothing_has_no_such_page(tmp_path):
    write_run(tmp_path / "run" / "0", "bm", 0, 0.5, size=Size(points=5, episodes=10))
    assert "query" not in {page.name for page in build_pages(collect([tmp_path]))}


def test_a_real_run_is_reported(choose_run, copy_of, tmp_path):
    run = copy_of(choose_run).path
    for split in ("S1", "S5"):
        test = (SplitTest(split=split),)
        evaluate(run, episodes=8, test=test, probes=(FilmsProbe(episodes=4),))
    study = collect([run])
    page = next(page for page in build_pages(study) if page.name == "query")
    blocks = flat(page.blocks)
    found = [getattr(block, "table", block) for block in blocks]  # of figures
    tables = {
        table.name.split("-irb120")[0]: table.rows
        for table in found
        if isinstance(table, DataTable)
    }
    names = {"choice", "reach", "switched", "choice-curves", "query-types"}
    assert set(tables) == names
    assert [row["split"] for row in tables["choice"]] == ["S1", "S5"]
    kinds = {row["type"] for row in tables["query-types"]}
    assert {"usedFor", "hasColor"} & kinds
    kinds = [block.kind for block in flat(page.blocks) if getattr(block, "kind", "")]
    assert kinds == ["no control"] * 2
    films = behaviour.film_blocks(study.tasks[0])
    assert all("asked for “" in each.title for each in films)
    outcome = TEMPLATES.get_template("blocks.html.j2").make_module().outcome
    texts = [outcome(film.episode) for each in films for film in each.films]
    assert any(text.startswith("chose the ") for text in texts)
    assert behaviour.query_words("usedFor drinking and hasColor light_blue") == (
        "used for drinking and has color light blue"
    )
    written = write_report([run], tmp_path / "report.html").read_text()
    assert "Was the query understood?" in written


@pytest.mark.parametrize("has_policy", [True, False])
def test_what_is_seen_and_solved_stands_beside_the_policy_and_is_no_choice_of_it(
    tmp_path, has_policy
):
    study_of(tmp_path, on("S1", EVERY if has_policy else {"subgraph": 0.9}))
    for folder in tmp_path.glob("*subgraph-fast/*/evaluation/post-training-greedy-s1"):
        solved = shutil.copytree(folder, folder.with_name(f"{folder.name}-seen"))
        summary = read_json(solved / "summary.json")
        summary["config"]["test"].append({"kind": "seen"})
        summary["config"]["label"] = solved.name
        for name in ("success", "choice"):
            summary["numbers"][name] = {"estimate": 0.1, "low": 0.05, "high": 0.15}
        write_json(solved / "summary.json", summary)
        if not has_policy:
            shutil.rmtree(folder)
    study = collect([tmp_path])
    (task,) = study.tasks
    (table,) = [b for b in result_blocks(task) if b.name.startswith("solved")]
    (row,) = table.rows
    assert (row["agent"], row["split"], row["seeds"]) == ("subgraph", "S1", 3)
    assert row["solved"].estimate == pytest.approx(0.1)
    assert bool(row["success"]) == has_policy
    assert ("S1" in task.splits) == has_policy
    if has_policy:
        assert row["success"].estimate > 0.6
        assert only(study).kind == "understood"
    assert task.label == ("post-training-greedy-s1" if has_policy else "")
