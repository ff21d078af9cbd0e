"""Agents trained with privileged state play from images alone."""

import dataclasses
import shutil

import numpy as np
import pytest

from knowarm.config import to_dict
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.experiment.load import load_agent
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run import train
from knowarm.learn.algorithms import privileged_uses
from knowarm.learn.checkpoint import CheckpointStore, read_checkpoint
from knowarm.world.envs import privileged, torch_env
from tests.tiny import TINY

EVALUATION = EvaluationConfig(episodes=6, probes=())


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Train an agent with knowledge of the target, with randomized colours, for a few updates."""
    config = experiment_config("irb120-target+-dr-fast", **TINY)
    assert privileged_uses(to_dict(config.algorithm)) == ["critic", "auxiliary loss"]
    return train(config, tmp_path_factory.mktemp("runs")).folder


def results(folder):
    return evaluate(load_agent(folder.path, which="latest"), config=EVALUATION).episodes


def test_nothing_of_the_privileged_state_reaches_the_policy(run, tmp_path, monkeypatch):
    expected = results(run)
    # A copy without everything that the critic and the auxiliary head have left in it.
    shutil.copytree(run.path, tmp_path / "copy")
    copy = dataclasses.replace(run, path=tmp_path / "copy")
    latest = copy.checkpoints / "latest"
    names = set(read_checkpoint(latest).policy)
    assert names == set(load_agent(run.path, which="untrained").policy.state_dict())
    before = read_checkpoint(latest)
    assert any(name.startswith("critic/") for name in before.state)
    assert "auxiliary/weight" in before.state

    def refuse(*args):
        raise AssertionError("the privileged state was read in an evaluation")

    monkeypatch.setattr(privileged, "privileged_state", refuse)
    monkeypatch.setattr(torch_env, "privileged_state", refuse)
    stripped = dataclasses.replace(before, optimizer={}, state={})
    CheckpointStore(copy.checkpoints, {}).save(stripped)
    for name, values in results(copy).items():
        np.testing.assert_array_equal(values, expected[name], err_msg=name)
