"""The host looks at no number of a rollout or a gradient: on the meta device there are none."""

import contextlib

import pytest
import torch

from knowarm.learn import PPOConfig
from knowarm.learn import tensor_collector as module
from knowarm.learn.solo import Solo
from knowarm.policy import Policy, PolicyConfig
from knowarm.policy.encoder import ImageEncoder

META, COUNT, SIDE = torch.device("meta"), 8, 24
CONFIG = PPOConfig(num_envs=COUNT, rollout_steps=6, minibatches=2)


class HostGenerator(torch.Generator):
    """A generator of the host, whatever device is asked for."""

    def __new__(cls, device="cpu"):
        return super().__new__(cls)


class Nowhere:
    """An environment of tensors without numbers."""

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
def nowhere(monkeypatch):
    """What the meta device lacks: generators, autocast, and the table's check before the start."""
    monkeypatch.setattr(Policy, "_products", lambda policy: contextlib.nullcontext())
    monkeypatch.setattr(ImageEncoder, "pixel_type", lambda encoder: torch.float32)
    monkeypatch.setattr(module, "sample", lambda logits, generator: logits.argmax(-1))
    monkeypatch.setattr(torch, "Generator", HostGenerator)
    monkeypatch.setattr(module, "check_table", lambda table, highest: None)
    monkeypatch.setattr(torch.Tensor, "__int__", lambda tensor: 0)


@pytest.mark.parametrize("fusion", ["before_lstm", "attention"])
def test_a_rollout_and_a_gradient_wait_for_nothing(nowhere, fusion):
    sizes = {"joints": 2, "image_size": SIDE, "features": 16, "knowledge_dim": 12}
    policy = Policy(PolicyConfig(**sizes, knowledge_slots=3, fusion=fusion)).to(META)
    table = torch.zeros((3, 12), device=META)
    learner = Solo(policy, CONFIG, table, "float32", META)
    collector = module.TensorCollector(Nowhere(), policy, table, seed=0)
    collector.collect(learner, learner.rollout)
    terms = learner.differentiate(torch.arange(4, device=META))
    assert terms.total.device == learner.gradient.device == META
    with pytest.raises((RuntimeError, NotImplementedError)):
        bool(terms.total > 0)
