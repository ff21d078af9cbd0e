"""The changes between the published A3C and the one that learns."""

import csv

import numpy as np
import pytest

from benchmarks import a3c_changes
from benchmarks.a3c_changes import (
    GROUPS,
    changed,
    differences,
    groups_of,
    name_of,
    outcome,
    published,
    settings,
    tuned,
)
from benchmarks.a3c_changes import variants as variants_of
from knowarm.experiment.csv_log import read_csv


def test_groups_name_every_difference_once():
    named = [name for group in GROUPS.values() for name in group]
    assert sorted(named) == sorted(differences())


def test_no_change_is_published_and_all_are_tuned():
    steps = 1_000_000
    assert settings(changed((), steps, 3)) == settings(published())
    assert settings(changed(tuple(GROUPS), steps, 3)) == settings(tuned())
    one = settings(changed(("discount",), steps, 3))
    different = {name for name, value in settings(published()).items() if one[name] != value}
    assert different == {"gamma", "gae_lambda"}
    assert (changed((), steps, 3).seed, changed((), steps, 3).total_steps) == (3, steps)


def test_variants_change_one_group_leave_one_out_or_take_those_named():
    assert variants_of("add", ())["pixels"] == ("pixels",)
    assert "pixels" not in variants_of("leave-out", ())["without-pixels"]
    assert len(variants_of("leave-out", ())["without-pixels"]) == len(GROUPS) - 1
    assert variants_of("set", ("pixels", "rewards")) == {"rewards+pixels": ("rewards", "pixels")}


def test_one_set_of_changes_has_one_name_in_every_mode():
    every = tuple(GROUPS)
    assert variants_of("set", every) == {"all": every}
    assert list(variants_of("set", every[1:])) == ["without-batch"]
    for groups in ((), *((name,) for name in GROUPS), every[3:], every[1:], every):
        assert groups_of(name_of(groups)) == groups
    with pytest.raises(ValueError, match="'rewards\\+colour'; changes: batch"):
        groups_of("rewards+colour")


def test_the_outcome_is_the_mean_of_the_last_evaluations(reach_run):
    rows = read_csv(reach_run.folder.evaluations_path)
    found = outcome(reach_run.folder)
    assert found["return_mean"] == sum(float(row["return_mean"]) for row in rows) / len(rows)
    log = read_csv(reach_run.folder.metrics_path)
    last = [row for row in log if float(row["step"]) > 0.8 * float(log[-1]["step"])]
    assert found["entropy"] == pytest.approx(np.mean([float(row["entropy"]) for row in last]))


def test_rows_of_the_csv_file_are_kept_and_not_trained_again(tmp_path, monkeypatch, capsys):
    path = tmp_path / "changes.csv"
    path.write_text("change,seed,steps,success\nnone,0,100,0.5\n")
    trained = []
    monkeypatch.setattr(
        a3c_changes,
        "measure",
        lambda config, runs: trained.append(config.seed) or {"success": 0.25},
    )
    words = ["changes", "set", "--steps", "100", "--seeds", "0", "1", "--csv", str(path)]
    monkeypatch.setattr("sys.argv", [*words, "--runs", str(tmp_path)])
    a3c_changes.main()
    assert trained == [1]
    assert [row["success"] for row in csv.DictReader(path.open())] == ["0.5", "0.25"]
