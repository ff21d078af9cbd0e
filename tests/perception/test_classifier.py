"""Facet classifiers: training, files, and agents that act on what they name."""

import copy
import json
import pickle
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from knowarm.cli.main import main
from knowarm.errors import UserError
from knowarm.experiment.build import build
from knowarm.experiment.conditions import Subject
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.evaluate import evaluate, known_in_test
from knowarm.experiment.load import load_agent
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run import train
from knowarm.experiment.run_folder import PERCEPTION_FILE, RunFolder, stored_module
from knowarm.perception import images as perception_images
from knowarm.perception import training
from knowarm.perception.agent import PerceivingVectorEnv
from knowarm.perception.classifier import FacetClassifier, NamedFacet
from knowarm.perception.config import PerceptionConfig
from knowarm.perception.images import query_answers, sample_images
from knowarm.perception.module import digest
from knowarm.perception.training import train_classifier, without_colours
from knowarm.reading import UnreadableFileError
from knowarm.world.agents.protocol import Batch
from knowarm.world.config import EnvConfig, HeldOut, facets_of
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.choose.choose import Choose
from tests.tiny import TINY

HASTY = PerceptionConfig(images=48, epochs=1, batch=16, test_images=8)
REACH = "irb120-target-perceived-dr-fast"
CHOOSE = "irb120-choose-target-perceived-fast"
SMALL_ENV = {"dynamics": "kinematic", "image_size": 32}
QUERIES = {"pairs": "none", "hold_out": []}
SMALL_CHOICE = SMALL_ENV | {"task": {"objects": 2, "queries": QUERIES}}


def config_of(name: str) -> ExperimentConfig:
    return experiment_config(name, env=SMALL_CHOICE if name == CHOOSE else SMALL_ENV)


def env_of(name: str) -> EnvConfig:
    return config_of(name).env


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, Path]:
    """A module of each task, hardly trained."""
    folder = tmp_path_factory.mktemp("modules")
    found = {}
    for name in (REACH, CHOOSE):
        found[name] = folder / f"{name}.safetensors"
        train_classifier(env_of(name), HASTY).write(found[name])
    return found


@pytest.fixture(scope="module")
def runs(files, tmp_path_factory) -> dict[str, RunFolder]:
    """A run of each task; the module that it was given is gone."""
    folder, found = tmp_path_factory.mktemp("runs"), {}
    for name, path in files.items():
        given = Path(shutil.copy(path, folder))
        found[name] = train(config_of(name), folder, perception=given, **TINY).folder
        given.unlink()
    return found


def test_a_module_learns_what_it_sees():
    """Of six facets in small images, a few seconds suffice for nearly all."""
    env = EnvConfig(colours="randomized", dynamics="kinematic", image_size=32)
    config = PerceptionConfig(images=1_000, epochs=12, batch=32, test_images=200)
    accuracy = train_classifier(env, config).spec.accuracy
    assert accuracy["new images"]["both"] > 0.9
    assert set(accuracy) == {"new images", "visual randomization"}


def test_the_same_seed_gives_the_same_bytes():
    first, second = (train_classifier(env_of(REACH), HASTY).to_bytes() for _ in range(2))
    assert first == second
    assert train_classifier(env_of(REACH), replace(HASTY, seed=1)).to_bytes() != first


def test_labels_are_the_visible_objects():
    env = env_of(CHOOSE)
    spec = train_classifier(env, replace(HASTY, images=1)).spec
    starts = sample_images(env, spec, 6, 3)
    world = ArmVectorEnv(env, 6)
    images, infos = world.reset(seed=3)
    assert (starts.images.numpy() == images).all()
    assert (starts.queries.numpy() == world.knowledge_input).all()
    for row, facets in enumerate(starts.facets.tolist()):
        names = [spec.facets[i][0] for i in facets]
        assert names == [world.scene.targets[i].name for i in infos["objects"][row]]
        assert "/".join(spec.facets[facets[0]]) == infos["facet"][row]
    answers = query_answers(env, spec.facets).satisfies
    assert answers[starts.queries, starts.facets[:, 0]].all()
    assert not answers[starts.queries[:, None], starts.facets[:, 1:]].any()


def test_held_out_colours_are_not_trained_on_and_tested_apart():
    held = replace(HASTY, held_out_colours=("blue", "purple", "light_blue"))
    env = without_colours(env_of(REACH), held.held_out_colours)
    perception = train_classifier(env_of(REACH), held)
    spec = perception.spec
    shown = {spec.facets[i][1] for i in sample_images(env, spec, 60, 0).facets.unique().tolist()}
    assert shown == {"red", "yellow", "brown"}
    assert "held-out colours" in spec.accuracy
    assert spec.config.held_out_colours == held.held_out_colours
    own = replace(env_of(REACH), held_out=HeldOut(colours=("yellow",)))
    assert without_colours(own, ("blue", "yellow")).held_out.colours == ("yellow", "blue")
    with pytest.raises(UserError, match="cannot be combined with the task 'choose'"):
        without_colours(env_of(CHOOSE), held.held_out_colours)


def test_a_file_is_read_back(files, tmp_path):
    for name, path in files.items():
        perception = FacetClassifier.read(path)
        again = tmp_path / f"{name}.safetensors"
        perception.write(again)
        assert again.read_bytes() == path.read_bytes()
        images = torch.zeros((2, 32, 32, 3), dtype=torch.uint8)
        assert perception(images).shape == (2, len(perception.spec.facets))


def test_a_module_is_sent_to_processes_as_its_file(files):
    module = FacetClassifier.read(files[CHOOSE])
    for again in (pickle.loads(pickle.dumps(module)), copy.deepcopy(module)):
        assert again.to_bytes() == files[CHOOSE].read_bytes()
        assert not again.training


@pytest.mark.parametrize("field", ["images", "epochs", "batch", "test_images", "learning_rate"])
def test_numbers_out_of_range_are_refused(field):
    with pytest.raises(UserError, match=f"PerceptionConfig.{field} must be"):
        PerceptionConfig(**{field: 0})


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda data: data[: len(data) // 2], "damaged or of another format"),
        (lambda data: b"", "damaged or of another format"),
        (lambda data: data.replace(b"knowarm-perception-1", b"knowarm-perception-9"), "expected"),
        (lambda data: data.replace(b"mug", b"mag", 1), "do not fit the facets"),
        (lambda data: data[:-4] + b"\xff\xff\xff\x7f", "non-finite"),
    ],
)
def test_a_damaged_file_is_one_kind_of_error(files, tmp_path, damage, message):
    path = tmp_path / "broken.safetensors"
    path.write_bytes(damage(files[REACH].read_bytes()))
    with pytest.raises(UnreadableFileError, match=message):
        FacetClassifier.read(path)


def test_a_module_of_something_else_is_refused(files, tmp_path):
    reach = FacetClassifier.read(files[REACH])
    for env, message in (
        (env_of(CHOOSE), "number of visible objects of 1, and this task has 2"),
        (replace(env_of(REACH), robot="tiago"), "for the robot irb120, and this task has tiago"),
        (replace(env_of(REACH), image_size=64), "image size of 32, and this task has 64"),
        (replace(env_of(REACH), targets=("mug", "lamp")), "does not know .* lamp"),
    ):
        table = np.zeros((len(facets_of(env)), 1), np.float32)
        with pytest.raises(UserError, match=message):
            NamedFacet(reach, env, table)


def test_a_module_is_needed_and_only_where_it_is_used(files, tmp_path):
    with pytest.raises(UserError, match="needs a perception module: pass perception='FILE'"):
        train(REACH, tmp_path, env=SMALL_ENV, **TINY)
    with pytest.raises(UserError, match="leave perception out"):
        train("irb120-bm-dr-fast", tmp_path, perception=files[REACH], env=SMALL_ENV, **TINY)
    with pytest.raises(UserError, match="Cannot read"):
        train(REACH, tmp_path, perception=tmp_path / "none.safetensors", env=SMALL_ENV, **TINY)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", [REACH, CHOOSE])
def test_a_run_keeps_its_module(files, runs, name):
    folder = runs[name]
    assert (folder.path / PERCEPTION_FILE).read_bytes() == files[name].read_bytes()
    assert folder.provenance().perception["digest"] == digest(files[name].read_bytes())
    trained = load_agent(folder.path)
    assert isinstance(trained.agent.recognition, NamedFacet)
    test = [{"kind": "split", "split": "S5"}] if name == CHOOSE else []
    how = {"episodes": 6, "probes": (), "test": test}
    result = evaluate(trained, **how)
    assert 0 <= result.summary["success"] <= 1
    assert evaluate(folder.path, **how).summary == result.summary


def test_a_test_with_other_objects_has_their_rows(runs):
    trained = load_agent(runs[REACH].path)
    env = replace(trained.config.env, targets=("bottle", "mug"))
    agent = known_in_test(trained, Subject(env=env, config=trained.config))
    rows = [facets_of(trained.config.env).index(facet) for facet in facets_of(env)]
    np.testing.assert_array_equal(agent.recognition.table, trained.table[rows])


def test_a_run_resumes_with_its_own_module(files, runs, tmp_path):
    config = config_of(REACH)
    part = train(config, tmp_path, perception=files[REACH], **(TINY | {"total_steps": 20})).folder
    train(config, tmp_path, resume=True, **TINY)
    policies = [load_agent(run.path, which="latest").policy for run in (runs[REACH], part)]
    for name, value in policies[0].state_dict().items():
        assert torch.equal(value, policies[1].state_dict()[name]), name
    other = tmp_path / "other.safetensors"
    train_classifier(env_of(REACH), replace(HASTY, seed=5)).write(other)
    with pytest.raises(UserError, match="trained with another perception module"):
        train(config, tmp_path, resume=True, perception=other, **TINY)
    assert load_agent(part.path, perception=other).policy is not None
    (part.path / PERCEPTION_FILE).write_bytes(other.read_bytes())
    with pytest.raises(UnreadableFileError, match="not the module that this run was trained with"):
        stored_module(config, part)


@pytest.mark.parametrize("name", [REACH, CHOOSE])
def test_the_policy_gets_nothing_privileged(files, name, monkeypatch):
    """With labels that raise when they are read, agent and environment choose the same rows."""
    env, perception = env_of(name), FacetClassifier.read(files[name])
    policy = build(config_of(name))
    world = ArmVectorEnv(env, 6)
    world.reset(seed=2)
    batch = Batch.of(world)

    def played() -> tuple[torch.Tensor, torch.Tensor]:
        images, _ = world.reset(seed=2)
        agent = NamedFacet(perception, env, policy.table).make_agent(
            policy.new_policy(0), greedy=True
        )
        agent.reset(batch)
        agent.act({"image": images})
        learner = NamedFacet(perception, env, policy.table).make_env(env, 6)
        learner.reset(seed=2)
        return agent.knowledge, learner.knowledge

    rows, learned = played()
    assert torch.equal(rows, learned)

    def refuse(*arguments, **options):
        raise AssertionError("labels were read")

    monkeypatch.setattr(perception_images, "first_facets", refuse)
    monkeypatch.setattr(training, "sample_images", refuse)
    true = policy.table[world.running.facet]
    if name == REACH:  # in the choose task these are the queries, which the agent receives
        monkeypatch.setattr(type(world), "knowledge_input", property(refuse))
        monkeypatch.setattr(PerceivingVectorEnv.__mro__[1], "knowledge_input", property(refuse))
        monkeypatch.setattr(Batch, "rows", np.full(6, -1))
    again, learned = played()
    assert torch.equal(rows, again)
    assert torch.equal(rows, learned)
    assert not np.array_equal(rows, true)  # a module that is hardly trained errs


def test_rows_follow_the_image_and_answer_the_query(files):
    env, perception = env_of(CHOOSE), FacetClassifier.read(files[CHOOSE])
    world = ArmVectorEnv(env, 8)
    images, _ = world.reset(seed=1)
    indices = np.arange(len(world.facets), dtype=np.float32)[:, None]
    select = NamedFacet(perception, env, indices)
    queries = torch.from_numpy(world.knowledge_input)
    for asked in (queries, queries.roll(1)):
        rows = select(torch.from_numpy(images), asked).squeeze(1).long()
        assert query_answers(env, world.facets).satisfies[asked, rows].all()


def test_an_episode_keeps_its_row_until_the_next_begins(files):
    env = replace(env_of(REACH), max_episode_steps=3)
    module = FacetClassifier.read(files[REACH])
    select = NamedFacet(module, env, build(experiment_config(REACH)).table)
    world = select.make_env(env, 6)
    world.reset(seed=4)
    start = world.knowledge.clone()
    actions = torch.zeros((6, 6), dtype=torch.int64)
    for step in range(1, 4):
        images, _, terminated, truncated, _ = world.step(actions)
        fresh = terminated | truncated
        assert bool(fresh.all()) == (step == 3)
        expected = torch.where(fresh[:, None], select(images, world.knowledge_input), start)
        assert torch.equal(world.knowledge, expected)
    state = world.get_state()
    other = select.make_env(env, 6)
    other.reset(seed=9)
    other.set_state(state)
    assert torch.equal(other.knowledge, world.knowledge)
    with pytest.raises(UserError, match="what was recognized"):
        other.set_state({name: value for name, value in state.items() if name != "perceived"})


def test_the_choice_task_is_perceived_with_questions_by_name(files, tmp_path):
    env = EnvConfig(task=Choose(), dynamics="kinematic", image_size=32)
    perception = train_classifier(env, replace(HASTY, images=16))
    assert {"answer"} <= set(perception.spec.accuracy["new images"])


def test_the_command_trains_prints_and_writes(tmp_path, capsys):
    out = tmp_path / "see.safetensors"
    options = ["--images", "24", "--epochs", "1", "--test-images", "6"]
    task = ["--env.image-size", "32", "--env.dynamics", "kinematic"]
    where = ["--out", str(out), "--json", str(tmp_path / "see.json")]
    assert main(["perception", "train", REACH, *where, *options, *task]) == 0
    assert "visual randomization" in capsys.readouterr().out
    values = json.loads((tmp_path / "see.json").read_text())
    assert values["accuracy"].keys() == FacetClassifier.read(out).spec.accuracy.keys()
    assert main(["perception", "train", REACH, "--out", "see.bin", *options, *task]) == 2
    assert "written as .safetensors" in capsys.readouterr().err
    assert main(["perception", "fit"]) == 2
    assert main(["perception", "train", "--out", "x"]) == 2
    assert main(["train", REACH, "--runs", str(tmp_path)]) == 2
    assert "pass --perception FILE" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["perception", "train", REACH, "--help"])
