"""Recipes of CONTRIBUTING.md: one registry entry adds a part to every command and experiment.

Each test adds a toy part by one entry, without touching any other file, and checks that it is
listed, trained and evaluated.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest
import torch

import knowarm
from knowarm.cli.main import main
from knowarm.experiment.algorithms import TrainerInputs
from knowarm.learn import Checkpoint, Trainer, TrainingResult
from knowarm.learn.checkpoint import policy_arrays
from knowarm.learn.config import AlgorithmConfig
from knowarm.policy.fusion import FUSIONS, Fusion
from knowarm.world import env_id, register_environments
from knowarm.world.robots import RobotEntry
from knowarm.world.scene import find_robot, find_targets

OWN = Path(__file__).parents[1] / "examples" / "own_robot"
TINY = {
    "total_steps": 40,
    "interim": {"every_steps": 40, "episodes": 2},
    "algorithm": {"num_envs": 4, "rollout_steps": 5, "minibatches": 2, "processes": 1},
}


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
    assert run.folder.experiment() == knowarm.experiment_config(name, **{**TINY, **overrides})
    result = knowarm.evaluate(run.folder.path, episodes=4, num_envs=4, record_films=0)
    assert result.write().is_dir()
    return run, result


def test_a_robot(monkeypatch, listed, tmp_path):
    robot = find_robot(str(OWN / "scara.toml"))
    monkeypatch.setitem(
        knowarm.ROBOTS, "toy", RobotEntry(title="Toy SCARA", env_id="ToyReach-v0", robot=robot)
    )
    register_environments()
    assert "toy" in listed()["robots"]
    assert knowarm.make(env_id("toy"), num_envs=2).reset(seed=0)[0].shape == (2, 64, 64, 3)
    run, _ = train_and_evaluate("toy-full-ppo", tmp_path)
    assert knowarm.load_agent(run.folder.path).policy.shape.joints == 4


def test_an_object(monkeypatch, listed, tmp_path):
    monkeypatch.setitem(knowarm.TARGETS, "bowl", find_targets([str(OWN / "bowl.toml")])[0])
    assert "bowl" in listed()["targets"]
    _, result = train_and_evaluate(
        "irb120-full-ppo", tmp_path, env={"targets": ("bowl", "mug"), "colours": "fixed"}
    )
    assert {"bowl", "mug"} >= set(result.episodes["target"])


class LSTMGate(Fusion):
    """Toy fusion: scale the LSTM's inputs by the mean of the knowledge."""

    def forward(self, layer, x, knowledge):
        return x * (1 + knowledge.mean(1, keepdim=True)) if layer == "lstm" else x


def test_a_fusion(monkeypatch, tmp_path):
    monkeypatch.setitem(FUSIONS, "lstm_gate", LSTMGate)
    run, _ = train_and_evaluate("irb120-full-ppo", tmp_path, policy={"fusion": "lstm_gate"})
    assert isinstance(knowarm.load_agent(run.folder.path).policy.fusion, LSTMGate)


def test_an_agent(monkeypatch, listed, tmp_path):
    agent = knowarm.Agent(
        about="control: the sentence of a graph with permuted tails, two hops",
        role="content_control",
        knowledge=knowarm.AGENTS["shuffled"].knowledge,
        colour="c-teal",
    )
    monkeypatch.setitem(knowarm.AGENTS, "toy-control", agent)
    assert listed()["agents"]["toy-control"] == agent.about
    run, _ = train_and_evaluate("irb120-toy-control-ppo", tmp_path)
    assert run.folder.config()["role"] == "content_control"


@dataclass(frozen=True, kw_only=True)
class RandomSearchConfig(AlgorithmConfig):
    """Toy algorithm: keep the initial policy of the best of several seeds."""

    name: Literal["random-search"] = "random-search"
    candidates: int = 2


class RandomSearchTrainer(Trainer):
    """Evaluate randomly initialized policies and keep the best one."""

    def __init__(self, config, policy, env, *, evaluate, **options):
        super().__init__(policy, evaluate=evaluate, **options)
        self.config, self.env, self.evaluate = config, env, evaluate

    def train(self, total_steps):
        self.env.reset(seed=0)
        while self.step < total_steps:
            self.policy.reset_parameters(torch.Generator().manual_seed(self.step))
            results = self.evaluate(self.policy)
            is_best = self.best.update(self.step, results["return_mean"])
            facts = {"step": self.step, "best_return": self.best.value, "best_step": self.step}
            checkpoint = Checkpoint(policy=policy_arrays(self.policy), facts=facts)
            self.checkpoints.save(checkpoint)
            if is_best:
                self.checkpoints.save_best(checkpoint)
            self.hooks.on_metrics({"step": self.step})
            self.hooks.on_evaluation(self.step, results, is_best)
            self.step += total_steps // self.config.candidates
        return TrainingResult(
            step=self.step,
            reason="finished",
            best_return=self.best.value,
            best_step=self.best.step,
        )

    def _train(self, total_steps):
        raise NotImplementedError

    def _restore(self, checkpoint):
        pass


def make_random_search(inputs: TrainerInputs) -> Trainer:
    return RandomSearchTrainer(
        inputs.config,
        inputs.policy,
        inputs.make_env(2),
        evaluate=inputs.make_evaluate(),
        **inputs.options,
    )


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
    run, _ = train_and_evaluate("irb120-full-random-search", tmp_path, algorithm={"candidates": 2})
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
    stored = json.loads((tmp_path / "cli/irb120-full-random-search/0/config.json").read_text())
    assert stored["algorithm"] == {"name": "random-search", "candidates": 1}
