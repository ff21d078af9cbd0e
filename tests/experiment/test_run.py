import dataclasses
import shutil

import numpy as np
import pytest
import torch

from knowarm.config import from_dict, to_dict
from knowarm.errors import UserError
from knowarm.experiment.agents import AGENTS
from knowarm.experiment.config import ExperimentConfig, StopWhen
from knowarm.experiment.csv_log import read_csv
from knowarm.experiment.load import load_agent
from knowarm.experiment.names import ExperimentName, experiment_config, tasks_of
from knowarm.experiment.run import Parts, build, train
from knowarm.experiment.run_folder import RunFolder
from knowarm.learn.checkpoint import (
    Checkpoint,
    CheckpointStore,
    policy_arrays,
    read_checkpoint,
)
from knowarm.reading import read_json, write_json
from knowarm.world.config import facets_of, questions_of
from knowarm.world.scene import scene
from tests.thorough import thorough
from tests.tiny import CHOOSE_NAME, short


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def curve(folder: RunFolder) -> list[dict[str, str]]:
    rows = read_csv(folder.metrics_path)
    # Names that end in _s are times and rates of the clock.
    return [
        {n: value for n, value in row.items() if not n.endswith("_s")} for row in rows
    ]


def test_a_run_folder_tells_all(reach_run):
    run = reach_run
    assert run.result.step == 160
    assert run.folder.experiment() == short()
    assert [int(row["step"]) for row in read_csv(run.folder.evaluations_path)] == [
        *range(0, 161, 20)
    ]
    assert len(curve(run.folder)) == 8
    provenance = run.folder.provenance()
    policy = build(short()).new_policy(0)
    assert provenance.parameter_counts == policy.parameter_counts()
    assert provenance.knowledge.constant
    assert provenance.facets[0] == ("mug", "red")
    assert run.folder.knowledge().shape == (3, 150)
    assert any(run.folder.tensorboard.iterdir())
    with pytest.raises(UserError, match="resume=True"):
        train(short(), run.folder.path.parents[1])
    with pytest.raises(UserError, match="is not a run folder"):
        train(short(), run.folder.path / "elsewhere", resume=True)


@pytest.mark.parametrize(
    "name", ["irb120-full-fast", *thorough((), ("irb120-full-ppo",))]
)
def test_the_number_of_cores_changes_no_byte(tmp_path, name):
    files = []
    for threads in (1, 3):
        torch.set_num_threads(threads)
        # The own network: threads share no work on small matrices.
        policy = experiment_config(name).policy
        run = train(short(name, policy=policy), tmp_path / str(threads))
        paths = [
            *run.folder.checkpoints.rglob("*.safetensors"),
            run.folder.evaluations_path,
        ]
        files.append(
            {path.relative_to(run.folder.path): path.read_bytes() for path in paths}
        )
    assert len(files[0]) > 3
    assert files[0] == files[1]


def test_stop_and_resume_give_the_same_bytes(reach_run, tmp_path):
    whole, asked = reach_run, []

    def after_four_updates() -> bool:
        asked.append(0)
        return len(asked) > 4

    part = train(short(), tmp_path / "part", should_stop=after_four_updates)
    assert part.result.reason == "stopped"
    assert part.result.step == 80
    resumed = train(short(), tmp_path / "part", resume=True)
    assert curve(whole.folder) == curve(resumed.folder)
    for name in ("policy", "optimizer", "state"):
        file = f"latest/{name}.safetensors"
        a = (whole.folder.checkpoints / file).read_bytes()
        assert a == (resumed.folder.checkpoints / file).read_bytes(), name
    assert (
        whole.folder.evaluations_path.read_bytes()
        == resumed.folder.evaluations_path.read_bytes()
    )


def test_a_stop_before_the_first_update_evaluates_once(reach_run, tmp_path):
    assert train(short(), tmp_path, should_stop=lambda: True).result.step == 0
    resumed = train(short(total_steps=20), tmp_path, resume=True)
    rows = read_csv(resumed.folder.evaluations_path)
    assert rows[0] == read_csv(reach_run.folder.evaluations_path)[0]
    assert [row["step"] for row in rows] == ["0", "20"]


@pytest.mark.parametrize("stop_after", [None, 2])
def test_a_training_ends_early_once_its_rule_is_met(tmp_path, stop_after):
    easy = dataclasses.replace(
        short().env, success_distance_m=2.0, success_angle_deg=180.0
    )
    config = short(env=easy, stop_when=StopWhen(success=1.0, evaluations=5))
    if stop_after is not None:
        asked = []
        train(
            config,
            tmp_path,
            should_stop=lambda: asked.append(0) or len(asked) > stop_after,
        )
    run = train(config, tmp_path, resume=stop_after is not None)
    assert (run.result.reason, run.result.step) == ("finished", 80)
    assert [row["step"] for row in read_csv(run.folder.evaluations_path)] == [
        "0",
        "20",
        "40",
        "60",
        "80",
    ]
    assert read_checkpoint(run.folder.checkpoints / "latest").facts["step"] == 80


def test_the_rule_of_an_early_end_counts_consecutive_evaluations():
    rule = StopWhen(success=0.5, evaluations=2)
    assert rule.met_at([(0, 0.5), (1, 0.4), (2, 0.6), (3, 1)]) == 3
    assert rule.met_at([(0, 0.5), (1, 0.4), (2, 0.6)]) is None
    for wrong in (
        {"success": 0.0},
        {"success": 1.5},
        {"success": 0.5, "evaluations": 0},
    ):
        with pytest.raises(UserError, match="stop_when"):
            StopWhen(**wrong)


def test_another_config_is_not_resumed(reach_run, copy_of):
    runs = copy_of(reach_run).path.parents[1]
    changed = dataclasses.replace(
        short(), policy=dataclasses.replace(short().policy, features=64)
    )
    with pytest.raises(UserError, match=r"policy\.features: 16 \| 64"):
        train(changed, runs, resume=True)
    assert train(short(total_steps=180), runs, resume=True).result.step == 180


def test_evaluations_of_a_policy_that_learns_on_are_set_aside(reach_run, copy_of):
    folder = copy_of(reach_run)
    folder.evaluation("random").mkdir(parents=True)
    write_json(folder.evaluation("random") / "summary.json", {"success": 0.5})
    runs = folder.path.parents[1]
    train(short(), runs, resume=True)  # nothing was left to train
    assert folder.evaluation("random").is_dir()
    train(short(total_steps=180), runs, resume=True)
    assert not (folder.path / "evaluation").exists()
    aside = folder.path / "evaluation-at-160" / "random" / "summary.json"
    assert read_json(aside) == {"success": 0.5}


def test_a_run_that_resumes_elsewhere_says_so(reach_run, copy_of, capsys):
    folder, config = copy_of(reach_run), short()
    runs = folder.path.parents[1]
    values = read_json(folder.path / "provenance.json")
    first = values["versions"] | {"torch": "2.0.0"}
    write_json(folder.path / "provenance.json", values | {"versions": first})
    edited = read_json(folder.config_path)
    edited["algorithm"]["learning_rate"] = 0.0007
    write_json(folder.config_path, edited)
    config = folder.experiment()
    for steps in (200, 240):  # the second goes on where the first was
        train(dataclasses.replace(config, total_steps=steps), runs, resume=True)
    provenance = folder.provenance()
    assert provenance.versions["torch"] == "2.0.0"
    (resumed,) = provenance.resumed
    assert resumed["step"] == 160
    assert resumed["versions"] == values["versions"]
    assert resumed["algorithm"]["learning_rate"] == 0.0007
    said = capsys.readouterr().err
    assert (
        said.count("versions.torch 2.0.0 |")
        == said.count("algorithm.learning_rate ")
        == 1
    )


def test_the_trained_agent_is_the_one_that_was_saved(reach_run):
    folder = reach_run.folder
    latest, untrained = (
        load_agent(folder.path, which=which) for which in ("latest", "untrained")
    )
    assert latest.step == 160
    assert untrained.step == 0
    fresh = build(short()).new_policy(0).state_dict()
    for name, value in untrained.policy.state_dict().items():
        torch.testing.assert_close(value, fresh[name], rtol=0, atol=0)
    assert not torch.equal(latest.policy.critic.weight, untrained.policy.critic.weight)


def test_a_truncated_checkpoint_is_refused(reach_run, copy_of):
    folder = copy_of(reach_run)
    file = folder.checkpoints / "best" / "policy.safetensors"
    file.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(UserError, match="damaged"):
        load_agent(folder.path)


def test_a_checkpoint_of_another_network_is_refused(reach_run, copy_of):
    full = copy_of(reach_run)
    fewer = dataclasses.replace(short().policy, hidden=8)
    other = policy_arrays(build(short(policy=fewer)).new_policy(0))
    CheckpointStore(full.checkpoints, {}).save_best(
        Checkpoint(policy=other, facts={"step": 1})
    )
    with pytest.raises(UserError, match=r"memory\.weight_hh"):
        load_agent(full.path)


SLOW = {"analogy"}  # trains a graph embedding


def few_tasks(agent, number):
    """Return the tasks of an agent; in `make test` one or two, and each task of some agents."""
    # Policies are not told enough to sort.
    tasks = [task for task in tasks_of(agent) if not task.endswith("sort")]
    first = number % len(tasks)
    last = -1 - first
    return thorough(sorted({tasks[first], tasks[last]}), tasks)


@pytest.mark.parametrize(
    ("name", "task"),
    [
        pytest.param(name, task, marks=[pytest.mark.slow] * (name in SLOW))
        for number, (name, agent) in enumerate(AGENTS.items())
        for task in few_tasks(agent, number)
    ],
)
def test_every_agent_can_be_built(name, task):
    config = ExperimentName("irb120", task, name, "randomized", "ppo").config()
    parts = build(config)
    table = questions_of(config.env)
    rows = len(facets_of(config.env)) if table is None else len(table.queries)
    width = parts.knowledge.embedding.dim if parts.knowledge.embedding else 0
    assert parts.knowledge.table.shape == (rows, width) or config.policy.wide
    width = parts.new_policy(0).knowledge_width
    assert width == parts.policy_shape.knowledge_dim or config.policy.wide
    assert np.isfinite(parts.knowledge.table).all()
    assert parts.new_policy(0).parameter_counts()["total"] > 0


@pytest.mark.parametrize("name", ["irb120-full-ppo", "tiago-bm-dr-a3c", CHOOSE_NAME])
def test_configs_survive_json(name):
    config = experiment_config(name)
    assert from_dict(ExperimentConfig, to_dict(config)) == config


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_a_missing_gpu_is_named_and_leaves_no_run(tmp_path):
    algorithm = dataclasses.replace(short().algorithm, device="cuda", processes=None)
    with pytest.raises(UserError, match="device 'cuda'"):
        train(short(algorithm=algorithm), tmp_path)
    assert list(tmp_path.rglob("config.json")) == []


def test_a_run_that_ended_before_its_first_checkpoint_starts_again(reach_run, copy_of):
    cut = copy_of(reach_run)
    shutil.rmtree(cut.checkpoints)
    again = train(short(), cut.path.parents[1], resume=True)
    assert curve(again.folder) == curve(reach_run.folder)
    evaluations = [read_csv(run.folder.evaluations_path) for run in (again, reach_run)]
    assert evaluations[0] == evaluations[1]


def test_training_seeds_share_neither_actions_nor_minibatches(tmp_path):
    states = []
    for seed in range(2):
        folder = train(short(total_steps=20, seed=seed), tmp_path).folder
        states.append(read_checkpoint(folder.checkpoints / "latest").state)
    for name in ("collector/generator", "order", "collector/env/streams"):
        assert not np.array_equal(states[0][name], states[1][name]), name


def test_each_training_seed_draws_its_own_placebo_and_keeps_it(tmp_path):
    config = short("irb120-random-ppo", total_steps=20)
    tables = [
        build(dataclasses.replace(config, seed=seed)).knowledge.table
        for seed in range(2)
    ]
    assert not np.array_equal(*tables)
    folder = train(config, tmp_path).folder
    np.testing.assert_array_equal(folder.knowledge(), tables[0])
    # A run goes on with the table it was started with, however a later version draws it.
    folder.write_knowledge(tables[1])
    resumed = train(dataclasses.replace(config, total_steps=40), tmp_path, resume=True)
    np.testing.assert_array_equal(
        load_agent(resumed.folder.path).agent.table, tables[1]
    )


def test_the_policy_is_built_once(tmp_path, monkeypatch):
    made, new_policy = [], Parts.new_policy
    monkeypatch.setattr(
        Parts,
        "new_policy",
        lambda parts, seed: made.append(seed) or new_policy(parts, seed),
    )
    train(short(total_steps=20, seed=3), tmp_path)
    assert made == [3]


@pytest.mark.parametrize("name", ["irb120-full-fast", "irb120-choose-query-words-fast"])
def test_building_needs_no_simulator(monkeypatch, name):
    monkeypatch.setattr(scene, "build_scene", None)
    scene._load_scene.cache_clear()
    assert build(experiment_config(name)).policy_shape.joints == 6
