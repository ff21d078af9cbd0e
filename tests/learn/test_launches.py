"""Budgets of kernels on a GPU: per gradient, and per step of the policy."""

from collections.abc import Callable

import pytest
import torch

from knowarm.learn import PPOConfig
from knowarm.learn.device import CudaGraph
from knowarm.learn.learner import Learner
from knowarm.learn.minibatch import TrainingNetwork
from knowarm.policy import Policy, PolicyConfig, PolicyShape, lstm, lstm_kernels
from knowarm.policy.encoder import ImageEncoder
from tests.launches import LaunchCounter

STEPS, COUNT, SIDE = 25, 4, 24


@pytest.fixture(params=["float32", "bfloat16"])
def learner(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Learner:
    """A learner whose network takes the branches of a GPU, on the CPU."""
    monkeypatch.setattr(lstm_kernels, "_can_compile", lambda tensor: False)
    monkeypatch.setattr(ImageEncoder, "_multiplies_blocks", lambda *arguments: True)
    policy = Policy(
        PolicyConfig(features=16),
        PolicyShape(joints=6, image_size=SIDE, knowledge_dim=9),
        torch.zeros(3, 9),
    )
    policy.matmul_precision = request.param
    config = PPOConfig(num_envs=COUNT, rollout_steps=STEPS, minibatches=1)
    return Learner(TrainingNetwork(policy, 0), config, request.param, torch.device("cpu"))


def launches_of_a_gradient(learner: Learner) -> int:
    env_ids = torch.arange(COUNT)
    learner.compute_gradient(env_ids)
    with LaunchCounter() as counter:
        learner.compute_gradient(env_ids)
    return counter.total


def test_a_gradient_with_triton_needs_few_kernels(
    learner: Learner, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("triton")
    from knowarm.policy import lstm_triton

    class Counted:
        launches = 0

        def __getitem__(self, grid: object) -> object:
            return self

        def __call__(self, *arguments: object) -> None:
            Counted.launches += 1

    for name in ("forward_kernel", "backward_kernel"):
        monkeypatch.setattr(lstm_triton, name, Counted())
    monkeypatch.setattr(lstm, "_uses_triton", lambda x: True)
    monkeypatch.setattr(lstm, "_triton", lambda: lstm_triton)
    operations = launches_of_a_gradient(learner)
    assert Counted.launches == 2 * 2 * STEPS, "one per step, forward and backward, of two calls"
    assert operations + 2 * STEPS <= 330


def test_a_gradient_without_triton_needs_a_thousand_more(learner: Learner) -> None:
    assert 1000 < launches_of_a_gradient(learner) <= 1250


def test_a_step_of_the_policy_needs_few_kernels(learner: Learner) -> None:
    image = torch.zeros(COUNT, SIDE, SIDE, 3, dtype=torch.uint8)
    state = learner.policy.initial_state(COUNT)
    with LaunchCounter() as counter:
        learner.infer(learner.rollout, 0, image, state)
    assert counter.total <= 65


def test_a_replayed_step_of_the_policy_only_copies(learner: Learner) -> None:
    recorded: list[object] = []

    def capture(run: Callable[[], None]) -> Callable[[], None]:
        run()
        return lambda: recorded.append(run)

    learner._step = CudaGraph(learner._infer, capture)
    image = torch.zeros(COUNT, SIDE, SIDE, 3, dtype=torch.uint8)
    _, state = learner.infer(learner.rollout, 0, image, learner.policy.initial_state(COUNT))
    with LaunchCounter() as counter:
        learner.infer(learner.rollout, 1, image, state)
    assert len(recorded) == 2, "one launch per step"
    # Image, facets, starts and state are copied in; patches, values and logits out.
    assert counter.seen == {"copy_.default": 7, "clone.default": 1}
