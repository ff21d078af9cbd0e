"""Single-process learner: gradients on the CPU and a GPU, launched or as a CUDA graph."""

import dataclasses

import numpy as np
import pytest
import torch

from knowarm.learn import PPOConfig
from knowarm.learn.data_parallel import make_learner
from knowarm.learn.minibatch import TrainingNetwork
from tests.devices import DEVICES
from tests.learn.toys import fill_with_noise, informed_toy_policy

TABLE = np.ones((2, 4), np.float32)
CONFIG = PPOConfig(
    num_envs=16, rollout_steps=6, minibatches=2, matmul_precision="float32", processes=1
)


def gradients(device, *, cuda_graphs):
    """Compute loss terms and gradients of two minibatches, of the second one twice."""
    config = dataclasses.replace(CONFIG, cuda_graphs=cuda_graphs)
    network = TrainingNetwork(informed_toy_policy(TABLE), 0)
    learner = make_learner(network, config, "float32", torch.device(device))
    fill_with_noise(learner, facets=2)
    results = []
    with learner.running():
        for first in (0, 8, 8):
            env_ids = torch.arange(first, first + 8, device=device)
            terms = learner.compute_gradient(env_ids)
            results.append((terms.vector().cpu(), learner.gradient.cpu().clone()))
    return results


@pytest.mark.parametrize("device", DEVICES)
def test_gradients_depend_on_the_minibatch_alone(device):
    (_, first), (terms, second), (terms_again, again) = gradients(device, cuda_graphs=True)
    assert not torch.allclose(first, second)
    torch.testing.assert_close(terms, terms_again)
    torch.testing.assert_close(second, again)


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_the_gradient_of_a_cuda_graph_is_the_launched_one_and_the_cpus():
    captured, launched = (gradients("cuda", cuda_graphs=on) for on in (True, False))
    on_cpu = gradients("cpu", cuda_graphs=False)
    for one, other, cpu in zip(captured, launched, on_cpu, strict=True):
        for a, b, c in zip(one, other, cpu, strict=True):
            torch.testing.assert_close(a, b)
            torch.testing.assert_close(a, c, rtol=1e-3, atol=1e-5)
