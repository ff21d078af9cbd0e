"""Tests of ``benchmarks.speed`` with tiny sizes."""

import json
import sys

import pytest

from benchmarks import devices, speed
from benchmarks.speed import measure_peak, measure_training, training_flops
from knowarm.experiment.names import experiment_config
from tests.tiny import ALGORITHM


@pytest.mark.slow
def test_every_speed_is_printed_and_written(capsys, monkeypatch, tmp_path):
    file = tmp_path / "speed.json"
    options = ["--seconds", "0.1", "--num-envs", "4", "--json", str(file)]
    monkeypatch.setattr(sys, "argv", ["speed", *options])
    speed.main()
    out = capsys.readouterr().out
    assert all(
        words in out for words in ("Simulation", "Images", "Training", "MFLOP", "hours")
    )
    values = json.loads(file.read_text())
    speeds = [value for name, value in values.items() if "_per_" in name]
    assert len(speeds) == 5
    assert all(value > 0 for value in speeds)
    expected = values["training_steps_per_s"] * values["training_flops"]
    assert values["share_of_peak"] == pytest.approx(
        expected / values["peak_flops_per_s"]
    )


def test_operations_are_counted_from_the_shapes_of_the_policy():
    """Hidden size 128: products of 64 patches of blocks, 36 positions, 1152, 256 and 43 inputs."""
    config = experiment_config("irb120-bm-ppo", algorithm={"epochs": 3})
    patches, positions = 256 * 27 * 16, 36 * 576 * 32
    dense = 1152 * 128 + 2 * 128 * 512 + 128 * (42 + 1)
    forward = 2 * (patches + positions + dense)
    # Without gradients of the pixels and of the first recurrent state's inputs.
    backward = 2 * forward - 2 * patches
    assert training_flops(config) == pytest.approx(4 * forward + 3 * backward, rel=0.02)


def test_muon_is_counted_per_minibatch():
    adam = experiment_config("irb120-bm-fast", algorithm={"optimizer": "adam"})
    muon = experiment_config("irb120-bm-fast", algorithm={"optimizer": "muon-float32"})
    half = experiment_config(
        "irb120-bm-fast", algorithm={"optimizer": "muon-float32", "minibatches": 4}
    )
    without, some, less = map(training_flops, (adam, muon, half))
    assert some - without == pytest.approx(2 * (less - without))
    assert some > without


def test_the_measured_peak_is_that_of_a_product():
    assert 1e8 < measure_peak(1, 0.01) < 1e14


@pytest.mark.parametrize(
    "name", ["irb120-bm-ppo", "irb120-choose-subgraph-ppo", "irb120-choose-answers-ppo"]
)
def test_training_is_measured_also_for_agents_with_a_module(name):
    config = experiment_config(name, algorithm=ALGORITHM)
    assert measure_training(config, 0.01) > 0


@pytest.mark.slow
def test_training_with_a3c_is_measured():
    algorithm = {"schedule": "asynchronous", "workers": 2}
    config = experiment_config("irb120-bm-a3c", algorithm=algorithm)
    assert measure_training(config, 0.01) > 0


@pytest.mark.slow
def test_devices_are_compared_by_what_they_learned(capsys, monkeypatch):
    options = ["--devices", "cpu", "--steps", "6400"]
    monkeypatch.setattr(devices, "ALGORITHMS", ("fast",))
    monkeypatch.setattr(sys, "argv", ["devices", *options])
    devices.main()
    out = capsys.readouterr().out
    assert out.count(" cpu ") == len(devices.ALGORITHMS)
    assert "6,400 steps" in out
