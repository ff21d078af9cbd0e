"""Learner in one process: gradients."""

import numpy as np
import torch

from knowarm.learn import PPOConfig
from knowarm.learn.learner import make_learner
from knowarm.learn.rollout import TrainingNetwork
from tests.learn.toys import fill_with_noise, informed_toy_policy

TABLE = np.ones((2, 4), np.float32)
CONFIG = PPOConfig(
    num_envs=16, rollout_steps=6, minibatches=2, matmul_precision="float32", processes=1
)


def gradients():
    """Compute loss terms and gradients of two minibatches, of the second one twice."""
    network = TrainingNetwork(informed_toy_policy(TABLE), 0)
    learner = make_learner(network, CONFIG, "float32", torch.device("cpu"))
    fill_with_noise(learner, facets=2)
    results = []
    with learner.running():
        for first in (0, 8, 8):
            env_ids = torch.arange(first, first + 8)
            terms = learner.compute_gradient(env_ids)
            results.append((terms.vector(), learner.gradient.clone()))
    return results


def test_gradients_depend_on_the_minibatch_alone():
    (_, first), (terms, second), (terms_again, again) = gradients()
    assert not torch.allclose(first, second)
    torch.testing.assert_close(terms, terms_again)
    torch.testing.assert_close(second, again)
