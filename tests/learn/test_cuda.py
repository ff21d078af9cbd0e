"""Training on a GPU; skipped where CUDA finds none."""

import pytest
import torch

from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run import train
from knowarm.learn import PPOConfig
from tests.learn.toys import noisy_learner
from tests.tiny import CHOOSE, CHOOSE_NAME, SHORT

pytestmark = pytest.mark.skipif(
    not torch.cuda.is_available(), reason="needs a GPU with CUDA"
)

ON_GPU = {"device": "cuda", "processes": None}


def gradient(device: str) -> tuple[torch.Tensor, torch.Tensor]:
    config = PPOConfig(num_envs=16, rollout_steps=6, minibatches=2)
    learner = noisy_learner(config, device=device)
    with learner.running():
        terms = learner.compute_gradient(torch.arange(8, device=device))
    return torch.stack([*terms.values()]).cpu(), learner.gradient.cpu()


def test_a_gpu_computes_the_losses_and_gradients_of_the_cpu():
    for expected, computed in zip(gradient("cpu"), gradient("cuda"), strict=True):
        torch.testing.assert_close(computed, expected, rtol=1e-3, atol=1e-5)


def on_gpu(name: str, settings: dict, **changes) -> ExperimentConfig:
    settings = settings | {"algorithm": settings["algorithm"] | ON_GPU} | changes
    return experiment_config(name, **settings)


RUNS = {
    name: on_gpu(name, SHORT)
    for name in (
        "irb120-full-ppo",
        "tiago-full-fast",
        "irb120-bm-dr-distil",
        "irb120-lift-full-fast",
    )
} | {CHOOSE_NAME: on_gpu(CHOOSE_NAME, CHOOSE)}


@pytest.mark.parametrize("name", RUNS)
def test_a_stopped_and_resumed_run_equals_an_uninterrupted_one_and_plays_on_the_cpu(
    tmp_path, name
):
    whole = train(RUNS[name], tmp_path / "whole")
    updates = iter((False, True))
    stopped = train(RUNS[name], tmp_path / "cut", should_stop=lambda: next(updates))
    assert stopped.result.reason == "stopped"
    resumed = train(RUNS[name], tmp_path / "cut", resume=True)
    policies = [
        (run.folder.checkpoints / "latest/policy.safetensors").read_bytes()
        for run in (whole, resumed)
    ]
    assert policies[0] == policies[1]
    assert evaluate(resumed, episodes=4, probes=()).summary["episodes"] == 4
