"""Whatever is wrong with run folders is named, and nothing crashes."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.experiment.evaluation import SplitTest
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run_folder import RunFolder
from knowarm.experiment.summary import EPISODE_COLUMNS, Summary, read_table, write_table
from knowarm.learn.algorithms import DistilConfig
from knowarm.reading import read_json
from knowarm.report import write_report
from knowarm.report.collect import collect
from knowarm.report.model import Evaluation
from knowarm.report.pages.paper import published_result
from knowarm.world.description import trust
from tests.report.synthetic_study import (
    LABEL,
    Size,
    Truth,
    edit_summary,
    env_of,
    robot_title,
    write_evaluation,
    write_run,
    write_study,
)
from tests.source_tree import SOURCE

LIGHT = Size(points=8, tables=False)
DAMAGED = '{"format": 1, "agent": "full", "seed": 0, "env": {}, "algorithm": "ppo"}'
TRUTH = Truth(success={"bm": 0.5, "full": 0.6})


def study(tmp_path: Path, seeds: int = 2) -> list[Path]:
    return write_study(tmp_path / "runs", TRUTH, seeds=seeds, size=LIGHT)


def named(found, path: Path) -> str:
    return " | ".join(f"{p.what}: {p.done}" for p in found.problems if p.path == path)


def edit(path: Path, **changes: object) -> None:
    values = json.loads(path.read_text())
    path.write_text(json.dumps(values | changes))


def test_runs_are_sorted_into_tasks_and_agents(tmp_path):
    paths = study(tmp_path)
    paths += write_study(tmp_path / "runs", TRUTH, seeds=1, robot="tiago", size=LIGHT)
    found = collect(paths)
    titles = [
        f"{robot_title(name)} · fixed colours · ppo" for name in ("irb120", "tiago")
    ]
    assert [task.title for task in found.tasks] == sorted(titles)
    assert {task.name for task in found.tasks} == {
        "irb120-fixed-colours-ppo",
        "tiago-fixed-colours-ppo",
    }
    assert [(g.name, len(g.runs)) for g in found.tasks[0].groups] == [
        ("bm", 2),
        ("full", 2),
    ]


def test_the_algorithm_is_that_of_the_config_whatever_the_name(tmp_path):
    path = write_run(tmp_path / "kitchen" / "0", "full", 0, 0.5, size=LIGHT)
    for given, shown in (
        ("fast", "fast"),
        ("a3c", "ppo"),
        ("", "ppo"),
    ):  # its trainer is PPO
        edit(path / "config.json", algorithm_name=given)
        assert collect([path]).tasks[0].title.endswith(f"· {shown}")


def test_a_folder_of_runs_is_searched_and_counts_once(tmp_path):
    study(tmp_path)
    assert len(collect([tmp_path, tmp_path / "runs"]).runs) == 4


@pytest.mark.parametrize(
    ("env", "algorithms", "tasks", "agents"),
    [
        (
            [{"mpi_rad": 0.1}, {"mpi_rad": 0.2}],
            ["ppo"],
            ["mpi_rad 0.1", "mpi_rad 0.2"],
            ["full"],
        ),
        # Of one trainer; the name of the run says nothing.
        ([{}], ["ppo", "fast", "a3c-tuned"], ["a3c-tuned", "fast", "ppo"], ["full"]),
        (
            [{"image_size": 64}, {"image_size": 96}],
            ["ppo"],
            ["ppo"],
            ["full · image_size=64", "full · image_size=96"],
        ),
    ],
)
def test_tasks_and_agents_of_one_name_are_told_apart(
    tmp_path, env, algorithms, tasks, agents
):
    for number, (changes, algorithm) in enumerate(product(env, algorithms)):
        path = tmp_path / "kitchen" / str(number)
        options = {"env": env_of() | changes, "algorithm": algorithm, "size": LIGHT}
        write_run(path, "full", number, 0.5, **options)
    found = collect([tmp_path])
    assert [task.title.split(" · ")[-1] for task in found.tasks] == tasks
    assert [group.name for group in found.tasks[0].groups] == agents
    assert not found.problems


def test_agents_of_one_name_are_told_apart_by_what_differs(tmp_path):
    paths = study(tmp_path)
    for path in paths[-2:]:
        other = tmp_path / "fixed" / path.name
        shutil.copytree(path, other)
        edit(other / "config.json", policy={"fusion": "before_lstm", "hidden": "fixed"})
        paths.append(other)
    names = [group.name for group in collect(paths).tasks[0].groups]
    assert names == ["bm", "full · hidden=grow", "full · hidden=fixed"]


def test_a_field_that_a_run_lacks_has_its_default(tmp_path):
    *_, last = paths = study(tmp_path)
    file = last / "config.json"
    config = json.loads(file.read_text())
    del config["algorithm"]["gamma"]
    file.write_text(json.dumps(config))
    assert len(collect(paths).tasks[0].groups) == 2


def test_what_is_no_run_folder_is_named(tmp_path):
    paths = study(tmp_path)
    (tmp_path / "empty").mkdir()
    packed = tmp_path / "study.tar.xz"
    packed.touch()
    found = collect([*paths, tmp_path / "empty", tmp_path / "nowhere", packed])
    assert f"knowarm study unpack {packed}: left out" in named(found, packed)
    assert "holds no run folder: left out" in named(found, tmp_path / "empty")
    assert "does not exist: left out" in named(found, tmp_path / "nowhere")
    with pytest.raises(UserError, match="Nothing to report"):
        collect([tmp_path / "empty"])


SUMMARY, INTERIM = f"evaluation/{LABEL}/summary.json", "evaluations.csv"


def with_row(number: int, *cells: str) -> Callable[[Path], None]:
    """Damage that replaces the first cells of a row, or all after them by nothing."""

    def damage(path: Path) -> None:
        lines = path.read_text().splitlines()
        lines[number] = ",".join([*cells, *lines[number].split(",")[len(cells) :]])
        path.write_text("\n".join(lines) + "\n")

    return damage


@pytest.mark.parametrize(
    ("file", "damage", "reason"),
    [
        *(
            ("config.json", text, "left out")
            for text in (
                "",
                "{",
                "[]",
                '{"format": 1}',
                '{"format": 1, "seed": 0}',
                DAMAGED,
            )
        ),
        ("config.json", {"format": 7}, "format 7"),
        ("config.json", {"seed": "0"}, "seed must be of type int, got '0'"),
        (
            "config.json",
            {"env": {"robot": ["irb120"]}},
            "env.robot must be of type str",
        ),
        (
            "config.json",
            {"total_steps": float("nan")},
            "total_steps must be of type int, got nan",
        ),
        ("config.json", {"knows": []}, "knows must hold the fields of one of"),
        ("config.json", {"agent": None}, "agent must be of type str, got None"),
        *(
            (SUMMARY, text, "the evaluation is left out")
            for text in ("", "{}", '{"episodes": 3, "success": "high"}', "[1]")
        ),
        (
            SUMMARY,
            {"numbers": {"success": float("inf")}},
            "numbers.success must be a finite",
        ),
        (
            SUMMARY,
            {"numbers": {"success": 1.0}},
            "lack episodes, accuracy, return_mean",
        ),
        (
            SUMMARY,
            {"groups": {"target": {"mug": {"success": "x"}}}},
            "groups.target.mug.success",
        ),
        (SUMMARY, {"format": 1}, "format 1, this version reads 2"),
        (INTERIM, b"\xff\xfe\x00step\n", "cannot be read"),
        *(
            (INTERIM, with_row(2, step), "1 damaged rows")
            for step in ("inf", "1e308", "-1")
        ),
        (
            "metrics.csv",
            with_row(2, "\0\0\0"),
            "1 damaged rows: the rows or cells are left out",
        ),
    ],
)
def test_damage_to_one_file_is_named_and_leaves_the_rest(
    tmp_path, file, damage, reason
):
    paths = study(tmp_path)
    path = paths[0] / file
    if callable(damage):
        damage(path)
    elif isinstance(damage, dict):
        edit(path, **damage)
    else:
        path.write_bytes(damage.encode() if isinstance(damage, str) else damage)
    found = collect(paths)
    of = path if path.suffix == ".csv" else path.parent
    assert reason in named(found, of)
    assert len(found.runs) == (3 if file == "config.json" else 4)
    assert all(np.isfinite(run.metrics["step"]).all() for run in found.runs)


def test_metrics_cut_short_by_a_crash_lose_only_their_last_line(tmp_path):
    path = study(tmp_path)[0] / INTERIM
    whole = path.read_text()
    path.write_text(whole + "99999999,12.")
    found = collect([tmp_path])
    assert "last line truncated: the line is left out" in named(found, path)
    run = next(run for run in found.runs if run.path == path.parent)
    assert len(run.interim["step"]) == len(whole.splitlines()) - 1


def test_missing_and_other_evaluations_are_named(tmp_path):
    paths = study(tmp_path, seeds=3)
    shutil.rmtree(paths[0] / "evaluation")
    (paths[1] / "evaluations.csv").unlink()
    other = paths[2] / "evaluation" / LABEL
    edit_summary(other, config={"distance_m": 0.05})
    found = collect(paths)
    assert "no post-training evaluation: kept" in named(found, paths[0])
    assert "no interim evaluations: kept" in named(found, paths[1])
    assert "other thresholds than most" in named(found, other)
    assert len(found.tasks[0].groups[0].runs) == 3
    assert len(found.tasks[0].groups[0].scores("success")) == 1


def test_other_versions_are_merged_and_said_to_be(tmp_path):
    paths = study(tmp_path)
    for path, version in zip(paths, ("1", "1", "1", "2"), strict=True):
        (path / "provenance.json").write_text(
            json.dumps({"versions": {"knowarm": version}})
        )
    found = collect(paths)
    assert len(found.runs) == 4
    assert "made with knowarm 2, most runs with 1: merged" in named(found, paths[3])


def test_of_two_rows_of_one_step_the_later_counts(tmp_path):
    paths = study(tmp_path)
    path = paths[0] / "evaluations.csv"
    lines = path.read_text().splitlines()
    again = lines[1].split(",")
    again[2] = "77"
    path.write_text("\n".join([*lines, ",".join(again)]) + "\n")
    run = next(run for run in collect(paths).runs if run.path == paths[0])
    assert run.interim["return_mean"][0] == 77
    assert (np.diff(run.interim["step"]) > 0).all()


def test_of_two_runs_of_one_seed_the_longer_counts(tmp_path):
    paths = study(tmp_path)
    short = write_run(
        tmp_path / "again" / "0",
        "bm",
        0,
        0.9,
        size=replace(LIGHT, total_steps=4_000_000),
    )
    path = short / "evaluations.csv"
    path.write_text("".join(line + "\n" for line in path.read_text().splitlines()[:4]))
    (short / "metrics.csv").unlink()
    found = collect([*paths, short])
    assert f"same agent, task and seed 0 as {paths[0]}" in named(found, short)
    assert len(found.tasks[0].groups[0].runs) == 2


def test_a_stopped_run_is_kept_and_named(tmp_path):
    paths = study(tmp_path)
    for name in ("evaluations.csv", "metrics.csv"):
        path = paths[0] / name
        path.write_text(
            "".join(line + "\n" for line in path.read_text().splitlines()[:5])
        )
    found = collect(paths)
    assert "stopped after 50% of its steps: kept; censored" in named(found, paths[0])
    edit(paths[0] / "config.json", stop_when={"success": 0.001, "evaluations": 1})
    edit(paths[1] / "config.json", stop_when=None)
    said = named(collect(paths), paths[0])
    assert "50% of its steps, as its stop_when says (success 0% 1x): kept" in said


def test_untrained_policies_are_references_and_never_compared(tmp_path):
    paths = study(tmp_path)
    generator = np.random.default_rng(0)
    for path in paths:
        folder = path / "evaluation" / f"{LABEL}-untrained"
        write_evaluation(folder, "bm", 0.0, env_of(), generator, LIGHT)
    task = collect(paths).tasks[0]
    assert task.label == LABEL
    assert [each.name for each in task.references] == ["untrained bm", "untrained full"]


@pytest.mark.parametrize("other", ["env", "split"])
def test_an_untrained_policy_of_another_task_is_no_reference(tmp_path, other):
    paths = study(tmp_path)
    folder = paths[0] / "evaluation" / f"{LABEL}-untrained"
    env = env_of() | ({"ignore_roll": True} if other == "env" else {})
    size = replace(
        LIGHT, evaluation={"test": (SplitTest(split="S4"),)} if other == "split" else {}
    )
    write_evaluation(folder, "bm", 0.0, env, np.random.default_rng(0), size)
    assert not collect(paths).tasks[0].references


@pytest.mark.parametrize("change", ["gone", "edited", "elsewhere"])
def test_seeds_trained_with_one_graph_are_one_agent(tmp_path, change):
    graphs = [tmp_path / "kitchen.csv", tmp_path / "other" / "kitchen.csv"]
    graphs[1].parent.mkdir()
    paths = []
    for seed in range(2):
        for graph in graphs:
            graph.write_text("head,relation,tail\nmug,usedFor,drinking\n")
        graph = str(graphs[seed if change == "elsewhere" else 0])
        config = experiment_config(
            "irb120-full-fast", seed=seed, knows={"graph": graph}
        )
        folder = RunFolder.create(tmp_path / "runs" / str(seed))
        folder.write_experiment(config)
        paths.append(folder.path)
        if seed == 0 and change == "gone":
            graphs[0].unlink()
    if change == "edited":
        graphs[0].write_text("changed")
    (group,) = collect(paths).tasks[0].groups
    assert (group.name, len(group.runs)) == ("full", 2)
    if change == "edited":  # a seed trained with the new content is another agent's
        config = experiment_config("irb120-full-fast", seed=2, knows={"graph": graph})
        (folder := RunFolder.create(tmp_path / "runs" / "2")).write_experiment(config)
        assert len(collect([*paths, folder.path]).tasks[0].groups) == 2


def test_a_report_is_written_whatever_is_missing(tmp_path):
    paths = write_study(
        tmp_path / "runs", TRUTH, seeds=2, size=Size(points=6, episodes=20)
    )
    evaluation = paths[0] / "evaluation" / LABEL
    (evaluation / "episodes.parquet").write_bytes(b"PAR1 broken")
    (paths[1] / "provenance.json").unlink()
    (paths[2] / "knowledge.safetensors").write_bytes(b"")
    shutil.rmtree(paths[3] / "evaluation")
    out = write_report(paths, tmp_path / "report.html")
    page = out.read_text()
    for path in (paths[1], paths[3]):
        assert str(path.relative_to(tmp_path).as_posix()) in page


def test_an_unwritable_place_is_refused(tmp_path):
    paths = study(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="Cannot write"):
        write_report(paths, tmp_path / "file" / "report.html")
    with pytest.raises(UserError, match=r"\.html"):
        write_report(paths, tmp_path / "report.pdf")


def test_a_robot_of_ones_own_is_named_by_its_file(tmp_path):
    """A run folder's copy of it lies in a folder of a hashed name."""
    runs = []
    for folder, mpi_rad in (("one", 0.03), ("other", 0.04)):
        robot = tmp_path / folder / "My Arm" / "mira.toml"
        robot.parent.mkdir(parents=True)
        text = (SOURCE / "world/robots/irb120/irb120.toml").read_text()
        text = text.replace('mjcf = "', f'mjcf = "{SOURCE}/world/robots/irb120/')
        robot.write_text(re.sub(r"mpi_rad = .*", f"mpi_rad = {mpi_rad}", text))
        trust(str(robot))
        for agent in ("bm", "full"):
            path = tmp_path / "runs" / folder / agent / "0"
            runs.append(write_run(path, agent, 0, 0.5, size=LIGHT))
            edit(path / "config.json", env=env_of(str(robot)))
    (alone,) = collect(runs[:2]).tasks
    assert alone.title == "mira · fixed colours · ppo"
    assert alone.name == "mira-fixed-colours-ppo"
    both = collect(runs).tasks
    assert len(both) == len({task.title for task in both}) == 2
    for task in both:
        assert task.title.startswith("mira · fixed colours · ppo · robot mira.toml (")


def test_held_out_colours_are_shown_beside_and_never_instead(tmp_path):
    paths = study(tmp_path, seeds=3)
    generator = np.random.default_rng(0)
    for path in paths:
        if (
            path.name == "0"
        ):  # more runs have the held-out evaluation than the usual one
            shutil.rmtree(path / "evaluation" / LABEL)
        folder = path / "evaluation" / f"{LABEL}-held-out"
        write_evaluation(folder, "x", 0.3, env_of(), generator, LIGHT)
    assert collect(paths).tasks[0].label == LABEL
    write_report(paths, tmp_path / "report.html")
    tables = json.loads((tmp_path / "report.json").read_text())["tables"]
    rows = tables["elsewhere-irb120-fixed-colours-ppo"]["rows"]
    assert [(row["agent"], row["seeds"]) for row in rows] == [("bm", 3), ("full", 3)]
    assert (
        rows[0]["difference_low"] < rows[0]["difference"] < rows[0]["difference_high"]
    )


def test_a_table_without_a_column_is_refused(tmp_path):
    paths = write_study(
        tmp_path / "runs", TRUTH, seeds=1, size=Size(points=5, episodes=9)
    )
    folder = paths[0] / "evaluation" / LABEL
    columns = read_table(folder / "episodes.parquet")
    kept = {name: each for name, each in EPISODE_COLUMNS.items() if name != "facet"}
    write_table(folder / "episodes.parquet", columns, kept)
    with pytest.raises(UserError, match="lacks values of facet"):
        Evaluation(folder, Summary.read(folder)).episodes()


def test_a_column_without_any_number_is_left_out(tmp_path):
    paths = study(tmp_path)
    for path in paths:
        rows = [
            line.split(",")
            for line in (path / "evaluations.csv").read_text().splitlines()
        ]
        rows = [rows[0], *([*row[:2], "", *row[3:]] for row in rows[1:])]
        (path / "evaluations.csv").write_text(
            "".join(",".join(row) + "\n" for row in rows)
        )
    assert "return_mean" not in collect(paths).runs[0].interim
    assert write_report(paths, tmp_path / "report.html").exists()


def test_only_reaching_learned_from_rewards_is_compared_with_the_paper(tmp_path):
    write_run(tmp_path / "reach" / "0", "full", 0, 0.5, size=LIGHT)
    (task,) = collect([tmp_path]).tasks
    assert published_result(task, "full")["accuracy"] == 0.92
    imitation = {"algorithm": to_dict(DistilConfig()), "algorithm_name": "distil"}
    own = read_json(tmp_path / "reach/0/config.json")
    edit(tmp_path / "reach/0/config.json", **imitation)
    (task,) = collect([tmp_path]).tasks
    assert published_result(task, "full") is None
    edit(tmp_path / "reach/0/config.json", **{name: own[name] for name in imitation})
    edit(
        tmp_path / "reach/0/config.json",
        env=env_of() | {"task": {"skill": {"kind": "lift"}}},
    )
    (task,) = collect([tmp_path]).tasks
    assert published_result(task, "full") is None
