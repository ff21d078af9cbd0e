"""Recipes of CONTRIBUTING.md: one registry entry adds a part to every command and experiment.

Each test adds a toy part by one entry, without touching any other file, and checks that it is
listed, trained and evaluated.
"""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import pytest
import torch

import knowarm
from knowarm.benchmark.suites import read_suite, suite_names
from knowarm.cli.main import main
from knowarm.knowledge.vectors import SOURCES, VectorSource
from knowarm.knowledge.vectors.source import Found
from knowarm.learn import AlgorithmConfig, Checkpoint, SynchronousTrainer, policy_arrays
from knowarm.policy.config import FUSIONS
from knowarm.policy.fusion import Fusion
from knowarm.report.collect import collect
from knowarm.report.verdicts.claims import claims
from knowarm.report.verdicts.knowledge import finding
from knowarm.world import env_id, register_environments
from knowarm.world.config import questions_of
from knowarm.world.objects.target import COLOURS
from knowarm.world.robots import find_robot
from knowarm.world.scene.scene import load_scene
from knowarm.world.tasks import find_task, task_names
from tests.report.synthetic_study import Size, Truth, write_study
from tests.tiny import TINY

OWN = Path(__file__).parents[1] / "examples" / "own_robot"


@pytest.fixture
def listed(tmp_path, capsys):
    """Return what ``knowarm list`` knows."""

    def read():
        assert main(["list", "--json", str(tmp_path / "list.json")]) == 0
        capsys.readouterr()
        return json.loads((tmp_path / "list.json").read_text())

    return read


def train_and_evaluate(name, folder, **overrides):
    """Train for a few steps, read the run folder back and evaluate it."""
    run = knowarm.train(name, folder, **{**TINY, **overrides})
    assert run.result.step == 40
    assert run.folder.experiment() == knowarm.experiment_config(
        name, **{**TINY, **overrides}
    )
    result = knowarm.evaluate(run.folder.path, episodes=4, probes=())
    assert result.write().is_dir()
    return run, result


def test_a_robot(monkeypatch, listed, tmp_path):
    robot = replace(find_robot(str(OWN / "scara.toml")), gym_name="Toy")
    monkeypatch.setitem(knowarm.ROBOTS, "toy", robot)
    register_environments()
    assert "toy" in listed()["robots"]
    assert knowarm.make(env_id("toy"), num_envs=2).reset(seed=0)[0].shape == (
        2,
        64,
        64,
        3,
    )
    run, _ = train_and_evaluate("toy-full-ppo", tmp_path)
    assert knowarm.load_agent(run.folder.path).policy.shape.joints == 4


def with_an_object():
    """Show the object "trophy"; check the frozen suites and print the targets of tasks."""
    assert load_scene("irb120", ("trophy", "mug")).colour_names[0] == tuple(COLOURS)
    for cell in (
        cell for name in suite_names() for cell in read_suite(name).cells.values()
    ):
        table = questions_of(cell.env)
        names = {""} if table is None else {query.name for query in table.queries}
        assert names >= set(cell.episodes.question.tolist()), cell.name
    print(
        json.dumps(
            [list(knowarm.TARGETS), {n: find_task(n).targets for n in task_names()}]
        )
    )


def test_an_object(tmp_path):
    """Two files beside those that ship add an object and change no task and no frozen suite."""
    copy = tmp_path / "knowarm"
    hidden = shutil.ignore_patterns("__pycache__")
    source = Path(knowarm.__file__).parent
    shutil.copytree(source, copy, ignore=hidden, copy_function=os.symlink)
    (copy / "world" / "objects" / "trophy.xml").symlink_to(OWN / "bowl.xml")
    (copy / "world" / "objects" / "trophy.toml").write_text(
        'mjcf = "trophy.xml"\ncoloured_geoms = ["outside", "foot"]\n'
    )
    paths = os.pathsep.join(map(str, (tmp_path, Path(__file__).parents[1])))
    code = "from tests.test_recipes import with_an_object; with_an_object()"
    printed = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": paths},
        cwd=tmp_path,
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    ).stdout
    targets, tasks = json.loads(printed.splitlines()[-1])
    assert set(targets) == {*knowarm.TARGETS, "trophy"}
    assert tasks == {name: list(find_task(name).targets) for name in task_names()}


class LSTMGate(Fusion):
    """Toy fusion: scale the LSTM's inputs by the mean of the knowledge."""

    def forward(self, layer, x, knowledge):
        return x * (1 + knowledge.mean(1, keepdim=True)) if layer == "lstm" else x


def test_a_fusion(monkeypatch, tmp_path):
    monkeypatch.setitem(FUSIONS, "lstm_gate", LSTMGate)
    run, _ = train_and_evaluate(
        "irb120-full-ppo", tmp_path, policy={"fusion": "lstm_gate"}
    )
    assert isinstance(knowarm.load_agent(run.folder.path).policy.fusion, LSTMGate)


@dataclass(frozen=True, kw_only=True)
class LetterCounts(VectorSource):
    """Toy source: a word's vector counts its letters."""

    kind: Literal["letters"] = "letters"
    name: ClassVar[str] = "letters"
    scale: float = 1.0
    dim: ClassVar[int] = 26

    def open(self, request):
        return self

    def find(self, part, coverage):
        words = part.label.split()
        coverage.how[part.label] = "words"
        counts = [
            [word.count(chr(97 + i)) * self.scale for i in range(26)] for word in words
        ]
        return Found(np.array(counts, np.float32), np.full(len(words), 0.01))


def test_an_embedding(monkeypatch, tmp_path):
    monkeypatch.setitem(SOURCES, "letters", LetterCounts)
    knowledge = {"source": {"kind": "letters", "scale": 0.5}, "dim": 26}
    run, _ = train_and_evaluate("irb120-full-ppo", tmp_path, knows=knowledge)
    assert run.folder.experiment().knows.source == LetterCounts(scale=0.5)
    assert run.folder.knowledge().shape == (3, 78)


def test_an_agent(monkeypatch, listed, tmp_path):
    agent = knowarm.Agent(
        about="control: the sentence of a graph with permuted tails, two hops",
        role="content_control",
        knows=knowarm.AGENTS["shuffled"].knows,
        colour="c-teal",
    )
    monkeypatch.setitem(knowarm.AGENTS, "toy-control", agent)
    assert listed()["agents"]["toy-control"] == agent.about
    run, _ = train_and_evaluate("irb120-toy-control-ppo", tmp_path)
    assert run.folder.config()["role"] == "content_control"


@pytest.mark.parametrize(
    ("success", "verdict"),
    [(0.35, "knowledge matters"), (0.75, "input without meaning")],
)
def test_the_verdict_on_an_agent_follows_its_role(
    monkeypatch, tmp_path, success, verdict
):
    """The only content control of the study is an agent that no file of the package names."""
    control = replace(knowarm.AGENTS["shuffled"], about="toy control")
    monkeypatch.setitem(knowarm.AGENTS, "toy-control", control)
    truth = {
        "bm": 0.35,
        "full": 0.75,
        "zeros": 0.35,
        "wide": 0.35,
        "toy-control": success,
    }
    size = Size(points=12, tables=False)
    study = collect(write_study(tmp_path, Truth(success=truth), seeds=6, size=size))
    assert finding(study.tasks[0], claims(study), "success").kind == verdict


@dataclass(frozen=True, kw_only=True)
class RandomSearchConfig(AlgorithmConfig):
    """Toy algorithm: keep the initial policy of the best of several seeds."""

    name: Literal["random-search"] = "random-search"
    candidates: int = 2


class RandomSearchTrainer(SynchronousTrainer):
    """Evaluate randomly initialized policies; the base class keeps the best one."""

    def __init__(self, config, policy, **options):
        super().__init__(policy, **options)
        self.config = config

    def update(self, total_steps):
        self.step += total_steps // self.config.candidates
        self.policy.reset_parameters(torch.Generator().manual_seed(self.step))
        return {}

    def checkpoint(self):
        return Checkpoint(policy=policy_arrays(self.policy), facts={"step": self.step})

    def restore(self, checkpoint):
        pass


def make_random_search(config, policy, make_env, **options):
    return RandomSearchTrainer(config, policy, **options)


def test_an_algorithm(monkeypatch, listed, tmp_path):
    algorithm = knowarm.Algorithm(
        about="random search over initial weights",
        config=RandomSearchConfig(),
        make_trainer=make_random_search,
        total_steps=40,
    )
    monkeypatch.setitem(knowarm.ALGORITHMS, "random-search", algorithm)
    assert "random-search" in listed()["algorithms"]
    assert "irb120-full-random-search" in listed()["experiments"]
    run, _ = train_and_evaluate(
        "irb120-full-random-search", tmp_path, algorithm={"candidates": 2}
    )
    assert run.folder.experiment().algorithm == RandomSearchConfig()
    assert (
        main(
            [
                "train",
                "irb120-full-random-search",
                "--runs",
                str(tmp_path / "cli"),
                "--algorithm.candidates",
                "1",
                "--interim.episodes",
                "2",
            ]
        )
        == 0
    )
    stored = json.loads(
        (tmp_path / "cli/irb120-full-random-search/0/config.json").read_text()
    )
    assert stored["algorithm"] == {"name": "random-search", "candidates": 1}
