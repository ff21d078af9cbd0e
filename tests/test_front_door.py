"""Public names of the package: each has an example here, and importing the package is cheap."""

import ast
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import knowarm
from knowarm.experiment.evaluation_files import read_film
from knowarm.study.executors import EXECUTORS, ExecutorEntry
from tests.study.tiny import Inline, InlineExecutor

SOURCE = Path(knowarm.__file__).parent
ZOO = SOURCE.parents[1] / "zoo" / "irb120-full-ppo"
TINY = {
    "total_steps": 40,
    "interim": {"every_steps": 40, "episodes": 2},
    "algorithm": {"num_envs": 4, "rollout_steps": 5, "minibatches": 2, "processes": 1},
}
EXAMPLES = {}


def example(*names):
    """Register the test below as the example of these names."""

    def register(function):
        for name in names:
            EXAMPLES[name] = function
        return function

    return register


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return knowarm.train("irb120-full-ppo", tmp_path_factory.mktemp("runs"), **TINY)


def test_importing_the_package_imports_nothing_heavy():
    heavy = {"torch", "mujoco", "numba", "scipy", "pyarrow", "PIL", "tyro", "rich", "jinja2"}
    code = "import sys, gymnasium; before = set(sys.modules); import knowarm; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert heavy & {name.split(".")[0] for name in loaded} == set()
    assert len([name for name in loaded if name.startswith("knowarm")]) < 20


def test_every_public_name_has_an_example_and_a_line_of_help():
    assert set(EXAMPLES) == set(knowarm.__all__) == set(dir(knowarm))
    for name in knowarm.__all__:
        assert name in knowarm.__doc__
        value = getattr(knowarm, name)
        if callable(value):
            assert value.__doc__
            assert not value.__doc__.startswith(f"{name}(")


def test_no_public_name_is_the_name_of_a_package():
    packages = {path.stem for path in SOURCE.iterdir() if path.suffix in ("", ".py")}
    assert packages & set(knowarm.__all__) == set()


def test_the_stub_imports_what_exists():
    tree = ast.parse((SOURCE / "__init__.pyi").read_text())
    names = [
        alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    ]
    assert sorted(names) == sorted(knowarm.__all__)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="trane"):
        knowarm.trane  # noqa: B018


@example("train", "Run")
def test_train(run):
    assert isinstance(run, knowarm.Run)
    assert run.result.step == 40
    longer = knowarm.train(
        run.folder.experiment(), run.folder.path.parents[1], resume=True, total_steps=60
    )
    assert longer.result.step == 60
    with pytest.raises(knowarm.UserError, match="resume=True"):
        knowarm.train("irb120-full-ppo", run.folder.path.parents[1], **TINY)


@example("evaluate", "EvaluationResult", "EvaluationConfig")
def test_evaluate(run):
    config = knowarm.EvaluationConfig(episodes=4, num_envs=4, record_films=1, blind_episodes=0)
    result = knowarm.evaluate(run.folder.path, config=config)
    assert isinstance(result, knowarm.EvaluationResult)
    assert len(result.episodes["return"]) == 4
    folder = result.write()
    assert folder == run.folder.path / "evaluation" / "post-training-greedy"
    assert read_film(folder / "films" / "0.webp").shape[1:] == (64, 64, 3)
    again = knowarm.evaluate(run.folder.path, config=config, episodes=2, record_films=0)
    assert again.summary["episodes"] == 2
    with pytest.raises(knowarm.UserError, match="'episodes'"):
        knowarm.evaluate(run.folder.path, episode=2)


@example("load_agent", "TrainedAgent", "PolicyAgent")
def test_load_agent():
    trained = knowarm.load_agent(ZOO)
    assert isinstance(trained, knowarm.TrainedAgent)
    assert isinstance(trained.agent, knowarm.PolicyAgent)
    result = knowarm.evaluate(trained, episodes=4, num_envs=4, record_films=0, blind_episodes=0)
    assert result.summary["agent"] == "irb120-full-ppo/0"
    assert result.summary["success"] > 0


@example("write_report")
def test_write_report(run, tmp_path):
    page = knowarm.write_report([run.folder.path], tmp_path / "report.html")
    assert "<html" in page.read_text()


@example("experiment_config", "experiment_names", "ExperimentConfig")
def test_experiment_config():
    assert "irb120-full-ppo" in knowarm.experiment_names()
    config = knowarm.experiment_config("irb120-full-ppo", seed=3, algorithm={"num_envs": 64})
    assert isinstance(config, knowarm.ExperimentConfig)
    assert (config.seed, config.algorithm.num_envs, config.algorithm.gamma) == (3, 64, 0.95)
    with pytest.raises(knowarm.UserError, match=r"field of algorithm.*num_envs"):
        knowarm.experiment_config("irb120-full-ppo", algorithm={"num_env": 64})


@example("make", "ReachVectorEnv", "TorchReachVectorEnv")
def test_make():
    image, _ = knowarm.make("irb120", image_size=32).reset(seed=0)
    assert image.shape == (32, 32, 3)
    env = knowarm.make("knowarm/TiagoReach-v0", num_envs=2)
    assert isinstance(env, knowarm.ReachVectorEnv)
    images, infos = env.reset(seed=0)
    env.step(env.action_space.sample())
    assert images.shape == (2, 64, 64, 3)
    assert infos["distance"].shape == (2,)
    tensors = knowarm.make("irb120", num_envs=2, device="cpu")
    assert isinstance(tensors, knowarm.TorchReachVectorEnv)
    assert isinstance(tensors.reset(seed=0)[0], torch.Tensor)


@example("EnvConfig", "ROBOTS", "TARGETS")
def test_env_config():
    config = knowarm.EnvConfig(robot="tiago", targets=("mug",), colours="randomized")
    assert config.robot in knowarm.ROBOTS
    assert set(config.targets) <= set(knowarm.TARGETS)


@example("read_graph", "KnowledgeGraph")
def test_read_graph(tmp_path):
    (tmp_path / "graph.tsv").write_text("mug\tisMadeOf\tceramic\nmug\thasColor\tred\n")
    graph = knowarm.read_graph(tmp_path / "graph.tsv")
    assert isinstance(graph, knowarm.KnowledgeGraph)
    assert len(graph) == 2


@example("scene_embedding", "SceneEmbedding", "KnowledgeConfig")
def test_scene_embedding():
    config = knowarm.KnowledgeConfig(detail="full")
    embedding = knowarm.scene_embedding(config, [("mug", "red"), ("bottle", "yellow")])
    assert isinstance(embedding, knowarm.SceneEmbedding)
    assert embedding.vector.shape == (100,)


@example("Policy", "PolicyConfig", "PolicyShape")
def test_policy():
    table = np.zeros((3, 150), np.float32)
    shape = knowarm.PolicyShape(joints=6, knowledge_dim=150, knowledge_slots=3)
    policy = knowarm.Policy(knowarm.PolicyConfig(fusion="film"), shape, table, seed=1)
    image = torch.zeros(2, 64, 64, 3, dtype=torch.uint8)
    facet, start = torch.tensor([0, 2]), torch.ones(2, dtype=torch.bool)
    logits, value, _ = policy.step(image, facet, policy.initial_state(2), start)
    assert logits.shape == (2, 6, 7)
    assert value.shape == (2,)


@example("PPOConfig", "A3CConfig", "ALGORITHMS", "Algorithm")
def test_algorithms():
    assert isinstance(knowarm.ALGORITHMS["ppo"], knowarm.Algorithm)
    assert knowarm.ALGORITHMS["ppo"].config == knowarm.PPOConfig()
    assert knowarm.A3CConfig(workers=2).workers == 2
    with pytest.raises(knowarm.UserError, match="gamma must lie between 0 and 1"):
        knowarm.PPOConfig(gamma=1.5)


@example("AGENTS", "Agent")
def test_agents(monkeypatch):
    mine = replace(
        knowarm.AGENTS["full"],
        about="full, two hops",
        knowledge=knowarm.KnowledgeConfig(detail="full", hops=2),
    )
    assert isinstance(mine, knowarm.Agent)
    monkeypatch.setitem(knowarm.AGENTS, "two-hops", mine)
    assert knowarm.experiment_config("irb120-two-hops-ppo").knowledge.hops == 2


@example("UserError")
def test_user_error():
    with pytest.raises(knowarm.UserError, match="Did you mean 'irb120'"):
        knowarm.train("irb12-full-ppo")


@example("StudyConfig", "read_study", "run_study")
def test_run_a_study(tmp_path, monkeypatch):
    entry = ExecutorEntry(about="in this process", default=Inline(), make=InlineExecutor)
    monkeypatch.setitem(EXECUTORS, "inline", entry)
    study = knowarm.StudyConfig(
        name="mine",
        experiments=("irb120-bm-ppo",),
        seeds=(0,),
        overrides=TINY,
        evaluations=(),
        where=Inline(),
    )
    (status,) = knowarm.run_study(study, tmp_path)
    assert status.state == "done"
    assert knowarm.read_study(tmp_path) == study
