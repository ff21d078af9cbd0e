"""Run folders of format 1 are read as what they were: a stored copy and all committed runs."""

import json
import shutil
from pathlib import Path

import pytest

from knowarm.config import from_dict, to_dict
from knowarm.experiment.build import load_agent
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.migration import (
    FORMAT,
    migrate_checkpoints,
    migrate_config,
    migrate_description,
    migrate_evaluation,
    migrate_provenance,
)
from knowarm.experiment.run_folder import RunFolder, read_csv
from knowarm.learn.checkpoint import read_checkpoint

ROOT = Path(__file__).parents[2]
STORED = Path(__file__).parent / "format_1"
RUNS = sorted(
    path.parent
    for folder in (ROOT / "zoo", ROOT / "docs" / "results")
    for path in folder.rglob("config.json")
)


def stored(name: str) -> dict:
    return json.loads((STORED / name).read_text())


def test_every_field_of_a_format_1_config_is_kept():
    values = stored("config.json")
    config = RunFolder.open(STORED).experiment()
    assert values["format"] == 1
    assert config.role == "knowledge"
    assert (config.name, config.agent, config.total_steps) == ("irb120-full-ppo", "full", 5_000_000)
    algorithm = values["algorithm"]
    assert config.algorithm.gae_lambda == algorithm["trace_decay"] == 0.95
    assert config.algorithm.clip_range == algorithm["clip"] == 0.2
    assert config.algorithm.vf_coef == algorithm["value_weight"] == 0.5
    assert config.algorithm.ent_coef == algorithm["entropy_weight"] == 0.003
    assert config.algorithm.max_grad_norm == algorithm["max_gradient_norm"] == 0.5
    assert config.algorithm.matmul_precision == algorithm["precision"] == "auto"
    for name, value in values["network"].items():
        assert getattr(config.policy, name) == value
    # What did not change its name or shape is equal in both formats.
    task = {"robot": "irb120-near", "mpi_rad": None}  # what was called irb120 with MPI .1
    assert {**to_dict(config.env), **values["env"], **task} == to_dict(config.env)
    assert to_dict(config.interim) == values["interim"]


def test_the_current_format_is_left_alone():
    migrated = migrate_config(stored("config.json"))
    assert migrated["format"] == FORMAT
    migrated["env"] = {**migrated["env"], "robot": "irb120", "mpi_rad": 0.1}
    assert migrate_config(migrated) == migrated
    provenance = migrate_provenance(stored("provenance.json"))
    assert migrate_provenance(provenance) == provenance


@pytest.mark.parametrize(
    ("changes", "role"),
    [
        ({"agent": "bm"}, "baseline"),
        ({"agent": "wrong-object"}, "content_control"),
        ({"agent": "wide"}, "capacity_control"),
        ({"agent": "target+"}, "privileged"),
        ({"agent": "mine"}, "knowledge"),
        ({"agent": "mine", "knowledge": {"detail": "none"}}, "baseline"),
        ({"agent": "mine", "knowledge": {"detail": "full", "scope": "target"}}, "privileged"),
    ],
)
def test_the_role_follows_from_the_agent(changes, role):
    assert migrate_config({"format": 1, **changes})["role"] == role


def test_provenance_separates_the_policy_s_choices_from_its_shape():
    values = stored("provenance.json")
    policy = migrate_provenance(values)["policy"]
    assert policy["shape"]["knowledge_dim"] == 150
    assert policy["config"]["fusion"] == "before_lstm"
    assert {**policy["config"], **policy["shape"]} == values["network"]


@pytest.mark.parametrize("config", [True, [1], "full", None])
def test_damaged_knowledge_in_provenance_is_left_alone(config):
    values = {"knowledge": {"config": config}}
    assert migrate_provenance(values) == values


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize(
    ("env", "task"),
    [
        ({"robot": "tiago", "mpi_rad": 0.1}, {"robot": "tiago-near", "mpi_rad": None}),
        ({"robot": "tiago", "mpi_rad": 0.2}, {"robot": "tiago-near", "mpi_rad": 0.2}),
        ({"robot": "tiago"}, {"robot": "tiago-near"}),
        ({"robot": "my.toml", "mpi_rad": 0.1}, {"robot": "my.toml", "mpi_rad": 0.1}),
        ({}, {}),
    ],
)
def test_runs_of_earlier_formats_keep_their_task(version, env, task):
    assert migrate_config({"format": version, "env": env})["env"] == task
    assert migrate_config({"format": FORMAT, "env": env})["env"] == env
    evaluation = {"format": 1, "env": env, "success": 1.0}
    assert migrate_evaluation(evaluation) == {"format": 2, "env": task, "success": 1.0}
    assert migrate_evaluation({**evaluation, "format": 2})["env"] == env


def test_columns_of_format_1_have_their_new_names(tmp_path):
    (tmp_path / "metrics.csv").write_text("step,gradient_norm,kl,clipped\n10,0.5,0.25,0\n")
    assert read_csv(tmp_path / "metrics.csv") == [
        {"step": "10", "grad_norm": "0.5", "approx_kl": "0.25", "clip_fraction": "0"}
    ]


@pytest.mark.parametrize("path", RUNS, ids=lambda path: str(path.relative_to(ROOT)))
def test_committed_runs_are_read(path):
    values = json.loads((path / "config.json").read_text())
    folder = RunFolder.open(path)
    config = folder.experiment()
    assert from_dict(ExperimentConfig, to_dict(config)) == config
    assert (config.name, config.seed) == (values["name"], values["seed"])
    suffix = "-near" if values["format"] < 3 else ""  # the task of earlier formats
    assert (config.env.robot, config.env.mpi_rad) == (f"{values['env']['robot']}{suffix}", None)
    assert set(folder.provenance()["policy"]) == {"config", "shape"}
    assert float(read_csv(folder.evaluations_path)[-1]["return_mean"]) > -200


@pytest.mark.parametrize("path", RUNS[-4:], ids=lambda path: path.name)
def test_a_shipped_policy_loads(path):
    trained = load_agent(path)
    assert trained.step > 0
    assert (
        trained.policy.parameter_counts()["total"]
        == (trained.folder.provenance()["parameter_counts"]["total"])
    )


def test_checkpoints_of_format_1_belong_to_their_migrated_run(tmp_path):
    shutil.copytree(ROOT / "zoo" / "irb120-full-ppo" / "checkpoints", tmp_path / "checkpoints")
    best = tmp_path / "checkpoints" / "best"
    before = json.loads((best / "meta.json").read_text())["description"]
    description = migrate_description(before, "irb120-near")
    assert (before["robot"], description["robot"]) == ("irb120", "irb120-near")
    assert migrate_description(before, "irb120")["robot"] == "irb120"
    assert description["policy.shape.joints"] == before["network.joints"] == 6
    assert description["policy.config.fusion"] == "before_lstm"
    migrate_checkpoints(tmp_path / "checkpoints", "irb120-near")
    assert read_checkpoint(best, description).facts["step"] == 4_851_200
    again = (best / "meta.json").read_bytes()
    migrate_checkpoints(tmp_path / "checkpoints", "irb120-near")
    assert (best / "meta.json").read_bytes() == again


def test_the_sums_of_a_format_1_a3c_run_are_renamed(tmp_path):
    meta = tmp_path / "latest" / "meta.json"
    meta.parent.mkdir()
    window = {"updates": 3, "gradient_norm": 7.5}
    meta.write_text(json.dumps({"description": {}, "facts": {"step": 9, "window": window}}))
    migrate_checkpoints(tmp_path, "irb120")
    facts = json.loads(meta.read_text())["facts"]
    assert facts == {"step": 9, "window": {"updates": 3, "grad_norm": 7.5}}
