"""One process on one device: gradients by single launches, or by one recording of them."""

import dataclasses

import numpy as np
import pytest
import torch

from knowarm.learn import PPOConfig
from knowarm.learn.learner import make_learner
from knowarm.learn.recording import Recording
from knowarm.learn.stopwatch import Stopwatch
from knowarm.policy import Policy, PolicyConfig
from tests.devices import DEVICES
from tests.learn.toys import JOINTS, LEVELS, SIDE

TABLE = np.ones((2, 4), np.float32)
CONFIG = PPOConfig(
    num_envs=16, rollout_steps=6, minibatches=2, matmul_precision="float32", processes=1
)


def gradient(device, *, cuda_graphs):
    """Loss terms and gradients of two minibatches, the second one's twice."""
    sizes = {"joints": JOINTS, "levels": LEVELS, "image_size": SIDE, "features": 16}
    policy = Policy(PolicyConfig(**sizes, knowledge_dim=4, actor_gain=1.0), seed=1)
    config = dataclasses.replace(CONFIG, cuda_graphs=cuda_graphs)
    made = make_learner(policy, config, TABLE, "float32", torch.device(device))
    rng = np.random.default_rng(0)
    shape = made.rollout.patches.shape
    made.rollout.patches.copy_(torch.from_numpy(rng.integers(0, 256, shape, np.uint8)))
    for tensor in (made.rollout.log_probability, made.targets.advantage, made.targets.returns):
        tensor.copy_(torch.from_numpy(rng.standard_normal(tensor.shape)))
    results = []
    with made.at_work():
        for first in (0, 8, 8):
            columns = torch.arange(first, first + 8, device=device)
            terms = made.differentiate(columns)
            results.append((terms.vector().cpu(), made.gradient.cpu().clone()))
    return results


@pytest.mark.parametrize("device", DEVICES)
def test_gradients_depend_on_the_minibatch_alone(device):
    (_, first), (terms, second), (terms_again, again) = gradient(device, cuda_graphs=True)
    assert not torch.allclose(first, second)
    torch.testing.assert_close(terms, terms_again)
    torch.testing.assert_close(second, again)


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_a_recorded_gradient_is_the_launched_one_and_the_cpus():
    recorded, launched = (gradient("cuda", cuda_graphs=on) for on in (True, False))
    for one, other, cpu in zip(recorded, launched, gradient("cpu", cuda_graphs=False), strict=True):
        for a, b, c in zip(one, other, cpu, strict=True):
            torch.testing.assert_close(a, b)
            torch.testing.assert_close(a, c, rtol=1e-3, atol=1e-5)


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_a_recording_takes_new_arguments_and_shapes():
    recording = Recording(lambda x: x * 2 + 1)
    for size in (3, 3, 5):
        x = torch.randn(size, device="cuda")
        torch.testing.assert_close(recording(x), x * 2 + 1)


@pytest.mark.parametrize("device", DEVICES)
def test_a_stopwatch_adds_up_and_leaves_out_what_lies_between(device):
    watch, x = Stopwatch(torch.device(device)), torch.ones(512, 512, device=device)
    assert watch.seconds() == 0
    watch.begin()
    y = x @ x
    watch.end()
    once = watch.seconds()
    for _ in range(20):
        y = y @ x
    assert watch.seconds() == once > 0
    watch.begin()
    y = y @ x
    watch.end()
    assert watch.seconds() > once
