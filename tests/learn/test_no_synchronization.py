"""Rollouts and gradients never read a value on the host: the meta device has none to read."""

import contextlib

import numpy as np
import pytest
import torch

from knowarm.learn import PPOConfig
from knowarm.learn import collector as module
from knowarm.learn.learner import Learner
from knowarm.learn.minibatch import TrainingNetwork
from knowarm.policy import Policy, PolicyConfig, PolicyShape
from knowarm.policy.encoder import ImageEncoder

META, COUNT, SIDE = torch.device("meta"), 8, 24
CONFIG = PPOConfig(num_envs=COUNT, rollout_steps=6, minibatches=2)


class CpuGenerator(torch.Generator):
    """A generator on the CPU whatever the device; the meta device has none."""

    def __new__(cls, device="cpu"):
        return super().__new__(cls)


class MetaEnv:
    """An environment whose tensors have no values."""

    num_envs, device, max_episode_steps = COUNT, META, 4

    @property
    def facet_ids(self):
        return torch.zeros(COUNT, dtype=torch.int64, device=META)

    def reset(self, **options):
        return torch.zeros((COUNT, SIDE, SIDE, 3), dtype=torch.uint8, device=META), {}

    def step(self, actions):
        assert actions.device == META
        image, flag = self.reset()[0], torch.zeros(COUNT, dtype=torch.bool, device=META)
        infos = {"final_obs": image, "final_info": {"is_success": flag}}
        return image, torch.zeros(COUNT, device=META), flag, flag, infos


@pytest.fixture
def meta_device(monkeypatch):
    """Replace what the meta device lacks: generators, autocast, and the check of facets."""
    monkeypatch.setattr(Policy, "_autocast", lambda policy: contextlib.nullcontext())
    monkeypatch.setattr(Policy, "check_facets", lambda policy, facet: None)
    monkeypatch.setattr(ImageEncoder, "pixel_type", lambda encoder: torch.float32)
    monkeypatch.setattr(module, "sample", lambda logits, generator: logits.argmax(-1))
    monkeypatch.setattr(torch, "Generator", CpuGenerator)
    monkeypatch.setattr(torch.Tensor, "__int__", lambda tensor: 0)


@pytest.mark.parametrize("fusion", ["before_lstm", "attention"])
def test_a_rollout_and_a_gradient_do_not_synchronize(meta_device, fusion):
    shape = PolicyShape(joints=2, image_size=SIDE, knowledge_dim=12, knowledge_slots=3)
    config = PolicyConfig(features=16, fusion=fusion)
    policy = Policy(config, shape, np.zeros((3, 12), np.float32)).to(META)
    learner = Learner(TrainingNetwork(policy, 0), CONFIG, "float32", META)
    collector = module.Collector(MetaEnv(), policy, seed=0)
    collector.collect(learner.rollout, learner.infer)
    terms = learner.compute_gradient(torch.arange(4, device=META))
    assert terms.total.device == learner.gradient.device == META
    with pytest.raises((RuntimeError, NotImplementedError)):
        bool(terms.total > 0)
