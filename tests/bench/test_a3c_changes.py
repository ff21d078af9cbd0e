"""The changes between the published A3C and the one that learns."""

import numpy as np
import pytest

from benchmarks import a3c_changes
from benchmarks.a3c_changes import (
    EXPERIMENT,
    GROUPS,
    differences,
    groups_of,
    name_of,
    names_of,
    outcome,
    published,
    settings,
    study_of,
    tuned,
)
from knowarm.experiment.csv_log import read_csv
from knowarm.study.driver import open_study
from knowarm.study.pack import unpack_study
from knowarm.study.status import study_status
from tests.bench.changes import write_run, write_runs


def test_groups_name_every_difference_once():
    named = [name for group in GROUPS.values() for name in group]
    assert sorted(named) == sorted(differences())


def test_no_change_is_published_and_all_are_tuned():
    def config(name):
        return study_of(name, 1_000_000, [3]).run(EXPERIMENT, 3)

    assert settings(config("none")) == settings(published())
    assert settings(config("all")) == settings(tuned())
    one = settings(config("discount"))
    different = {
        name for name, value in settings(published()).items() if one[name] != value
    }
    assert different == {"gamma", "gae_lambda"}
    assert (config("none").seed, config("none").total_steps) == (3, 1_000_000)
    assert config("pixels").interim.every_steps == 50_000


def test_a_mode_trains_single_changes_all_but_one_or_those_named():
    assert names_of("add", ()) == ["none", *GROUPS]
    assert groups_of("pixels") == ("pixels",)
    assert "without-pixels" in names_of("leave-out", ())
    assert set(groups_of("without-pixels")) == {*GROUPS} - {"pixels"}
    assert names_of("set", ("pixels", "rewards")) == ["rewards_pixels"]


def test_one_set_of_changes_has_one_name_in_every_mode():
    every = tuple(GROUPS)
    assert names_of("set", every) == ["all"]
    assert names_of("set", every[1:]) == ["without-batch"]
    assert names_of("set", every[3:]) == ["without-batch_bootstrap_learning-rate"]
    for groups in (
        (),
        *((name,) for name in GROUPS),
        every[:4],
        every[4:],
        every[1:],
        every,
    ):
        assert groups_of(name_of(groups)) == groups
    with pytest.raises(ValueError, match="'rewards_colour'; changes: batch"):
        groups_of("rewards_colour")


def test_the_outcome_is_the_mean_of_the_last_evaluations(reach_run):
    rows = read_csv(reach_run.folder.evaluations_path)[-a3c_changes.EVALUATIONS :]
    found = outcome(reach_run.folder)
    assert found["return_mean"] == pytest.approx(
        np.mean([float(row["return_mean"]) for row in rows])
    )
    log = read_csv(reach_run.folder.metrics_path)
    last = [row for row in log if float(row["step"]) > 0.8 * float(log[-1]["step"])]
    assert found["entropy"] == pytest.approx(
        np.mean([float(row["entropy"]) for row in last])
    )


def test_runs_that_are_done_are_kept_and_others_resume(tmp_path, monkeypatch):
    out = tmp_path / "100" / "none"
    study = study_of("none", 100, [0, 1, 2])
    write_run(study.run(EXPERIMENT, 0), out)
    write_run(study.run(EXPERIMENT, 1), out, step=40)
    trained = []

    def train(config, runs, *, resume):
        trained.append((config.seed, resume))
        write_run(config, runs, success=0.25)

    tables = []
    monkeypatch.setattr(a3c_changes, "train", train)
    monkeypatch.setattr(a3c_changes, "print_table", lambda *table: tables.append(table))
    monkeypatch.setattr(
        "sys.argv", ["_", "set", "--steps", "100", "--runs", str(tmp_path)]
    )
    a3c_changes.main()
    assert trained == [(1, True), (2, False)]
    ((_, columns, rows),) = tables
    assert columns[:3] == ["change", "seed", "success"]
    assert [row[:3] for row in rows] == [
        ["none", 0, 0.5],
        ["none", 1, 0.25],
        ["none", 2, 0.25],
    ]


def test_a_set_of_changes_is_packed_with_its_study(tmp_path, monkeypatch):
    runs, out = tmp_path / "runs", tmp_path / "packs"
    write_runs(runs, 100, {"rewards_pixels": [0.1, 0.2]})
    monkeypatch.setattr(
        "sys.argv", ["_", "pack", "--runs", str(runs), "--out", str(out)]
    )
    a3c_changes.main()
    (file,) = out.iterdir()
    assert file.name == "100-rewards_pixels.tar.xz"
    folder = unpack_study(file, tmp_path / "unpacked")
    study = open_study(folder)
    assert study == study_of("rewards_pixels", 100, [0, 1])
    assert [each.state for each in study_status(study, folder)] == ["done", "done"]


def test_a_run_that_is_not_done_is_not_packed(tmp_path):
    runs = tmp_path / "runs"
    write_runs(runs, 100, {"all": [0.1]})
    write_run(
        study_of("all", 100, [1]).run(EXPERIMENT, 1), runs / "100" / "all", step=40
    )
    with pytest.raises(SystemExit, match="irb120-full-a3c/1 is not done"):
        a3c_changes.pack(runs, tmp_path / "packs")
    assert not (tmp_path / "packs").exists()
