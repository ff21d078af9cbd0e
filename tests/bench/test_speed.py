"""Tests of ``knowarm bench`` with tiny sizes."""

import json

import pytest

from knowarm.cli.main import main
from knowarm.experiment.names import experiment_config
from knowarm.experiment.speed import measure_training
from tests.tiny import ALGORITHM


@pytest.mark.slow
def test_the_command_prints_and_writes_every_speed(capsys, tmp_path):
    file = tmp_path / "speed.json"
    assert main(["bench", "--seconds", "0.1", "--num-envs", "4", "--json", str(file)]) == 0
    out = capsys.readouterr().out
    assert all(words in out for words in ("Simulation", "Images", "Training", "hours"))
    values = json.loads(file.read_text())
    speeds = [value for name, value in values.items() if "_per_" in name]
    assert len(speeds) == 4
    assert all(speed > 0 for speed in speeds)


@pytest.mark.parametrize("name", ["irb120-bm-ppo", "irb120-choose-subgraph-ppo"])
def test_training_is_measured_also_for_agents_with_a_module(name):
    config = experiment_config(name, algorithm=ALGORITHM)
    assert measure_training(config, 0.01) > 0


@pytest.mark.slow
def test_training_with_a3c_is_measured():
    config = experiment_config("irb120-bm-a3c", algorithm={"workers": 2})
    assert measure_training(config, 0.1) > 0
