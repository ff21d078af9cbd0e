"""Single-process learner: gradients on the CPU and a GPU, launched or as a CUDA graph."""

import dataclasses

import numpy as np
import pytest
import torch

from knowarm.learn import PPOConfig
from knowarm.learn.collector import Collector, infer_step
from knowarm.learn.data_parallel import make_learner
from knowarm.learn.device import CudaGraph
from knowarm.learn.minibatch import TrainingNetwork
from tests.devices import DEVICES
from tests.learn.toys import fill_with_noise, informed_toy_policy, toy_env
from tests.tape import Tape

TABLE = np.ones((2, 4), np.float32)
CONFIG = PPOConfig(
    num_envs=16, rollout_steps=6, minibatches=2, matmul_precision="float32", processes=1
)


def rollouts(precision, recorder=None):
    """Collect two rollouts of episodes that end at different steps; return all they hold."""
    policy = informed_toy_policy(TABLE)
    learner = make_learner(TrainingNetwork(policy, 0), CONFIG, precision, torch.device("cpu"))
    policy.matmul_precision = precision
    if recorder is not None:
        learner._step = CudaGraph(learner._infer, recorder.capture)
    env = toy_env(16, recall=False, length=4, staggered=True, facets=2)
    collector = Collector(env, policy, seed=3)
    found = []
    with learner.running():
        for _ in range(2):
            collector.collect(learner.rollout, learner.infer)
            found.append({name: x.clone() for name, x in vars(learner.rollout).items()})
        # A gradient step changes the parameters in place: the recording reads the new ones.
        fill_with_noise(learner, facets=2)
        learner.compute_gradient(torch.arange(8))
        with torch.no_grad():
            for parameter in policy.parameters():
                parameter.sub_(parameter.grad)
        collector.collect(learner.rollout, learner.infer)
        found.append({name: x.clone() for name, x in vars(learner.rollout).items()})
    return found


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_rollouts_of_a_recorded_policy_are_those_of_an_executed_one(precision):
    executed = rollouts(precision)
    recorded = rollouts(precision, Tape())
    for one, other in zip(executed, recorded, strict=True):
        for name in one:
            assert torch.equal(one[name], other[name]), name
    assert not torch.equal(executed[0]["value"], executed[1]["value"])


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


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_the_policys_step_of_a_cuda_graph_is_the_launched_one():
    torch.manual_seed(0)
    policy = informed_toy_policy(TABLE).cuda()
    config = dataclasses.replace(CONFIG, cuda_graphs=True)
    device = torch.device("cuda")
    learner = make_learner(TrainingNetwork(policy, 0), config, "float32", device)
    fill_with_noise(learner, facets=2)
    state = learner.rollout.start_h.clone(), learner.rollout.start_c.clone()
    for t in range(2):
        image = torch.randint(256, (16, 20, 20, 3), dtype=torch.uint8, device=device)
        expected, (h, c) = infer_step(policy, learner.rollout, t, image, state)
        values, patches = learner.rollout.value[t].clone(), learner.rollout.patches[t].clone()
        logits, after = learner.infer(learner.rollout, t, image, state)
        torch.testing.assert_close((logits, *after), (expected, h, c))
        torch.testing.assert_close(learner.rollout.value[t], values)
        assert torch.equal(learner.rollout.patches[t], patches)
        state = h.clone(), c.clone()
