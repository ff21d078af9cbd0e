"""Streams of random numbers: independent between seeds, purposes and workers, and reproducible."""

from itertools import combinations, product
from typing import get_args

import numpy as np
import pytest
import torch

from knowarm.errors import UserError
from knowarm.learn.algorithms import PPOConfig
from knowarm.learn.ppo import PPOTrainer
from knowarm.learn.rollout import Collector
from knowarm.policy import Policy
from knowarm.seeding import Purpose, derive_seed, seed_sequence, torch_generator
from tests.learn.toys import SHAPE, toy_env, toy_policy

SEEDS = range(10)
PURPOSES = get_args(Purpose)
STREAMS = [(), *product(range(3), range(2))]
"""Indices of a trainer without workers, and of three A3C workers before and after a restart."""


def first_torch_draws(seed, purpose, *indices):
    return tuple(
        torch.rand(8, generator=torch_generator(seed, purpose, *indices)).tolist()
    )


def first_numpy_draws(seed, purpose, *indices):
    return tuple(
        np.random.default_rng(seed_sequence(seed, purpose, *indices)).random(8)
    )


@pytest.mark.parametrize("draws", [first_torch_draws, first_numpy_draws, derive_seed])
def test_seeds_purposes_and_workers_share_no_draws(draws):
    keys = list(product(SEEDS, PURPOSES, STREAMS))
    drawn = {draws(seed, purpose, *indices) for seed, purpose, indices in keys}
    assert len(drawn) == len(keys)


def test_the_same_seed_gives_the_same_bytes_everywhere():
    # Runs depend on these numbers: they must not change between versions, machines or devices.
    assert [derive_seed(seed, "actions") for seed in (0, 1)] == [
        7_229_315_352_737_646_089,
        1_275_975_541_612_323_131,
    ]
    assert derive_seed(0, "episodes", 16, 2) == 4_033_840_946_504_359_081
    for purpose in PURPOSES:
        one, other = (torch_generator(3, purpose) for _ in range(2))
        assert one.get_state().numpy().tobytes() == other.get_state().numpy().tobytes()
        assert one.initial_seed() == derive_seed(3, purpose)


def test_a_multiple_of_2_to_the_32_is_another_seed():
    """On the CPU PyTorch keeps 32 bits: with `manual_seed(2**32 * seed)` all seeds were equal."""
    old = [
        torch.rand(8, generator=torch.Generator().manual_seed(2**32 * s))
        for s in (0, 1)
    ]
    assert torch.equal(*old)
    assert first_torch_draws(0, "actions") != first_torch_draws(2**32, "actions")
    low_bits = {derive_seed(s, p) % 2**32 for s, p in product(SEEDS, PURPOSES)}
    assert len(low_bits) == len(SEEDS) * len(PURPOSES)


def ppo_draws(seed):
    """Return the first draws of a PPO training: weights, episodes, actions, minibatches."""
    policy = toy_policy(features=8, seed=seed)
    env = toy_env(8, recall=False, length=5)
    config = PPOConfig(
        num_envs=8, minibatches=2, processes=1, matmul_precision="float32"
    )
    trainer = PPOTrainer(config, policy, env, seed=seed)
    return (
        policy.critic.weight.detach().clone(),
        torch.tensor(env.env._seed),
        torch.rand(100, generator=trainer._collector.generator),
        torch.randperm(100, generator=trainer._minibatch_generator),
    )


def test_training_seeds_of_ppo_share_nothing():
    for one, other in combinations([ppo_draws(seed) for seed in range(4)], 2):
        assert not any(torch.equal(*pair) for pair in zip(one, other, strict=True))


def test_workers_of_a3c_share_nothing_and_start_differently_after_a_restart():
    policy, found = toy_policy(features=8), set()
    for seed, stream in product(range(3), STREAMS):
        env = toy_env(4, recall=False, length=5)
        collector = Collector(env, policy, seed=seed, stream=stream)
        found.add(env.env._seed)
        found.add(tuple(torch.rand(8, generator=collector.generator).tolist()))
    assert len(found) == 2 * 3 * len(STREAMS)


def test_initial_weights_have_their_own_stream():
    weights = Policy(toy_policy().config, SHAPE, seed=0).encoder.conv1.weight
    old = toy_policy()
    old.reset_parameters(torch_generator(0, "actions"))
    assert not torch.equal(weights, old.encoder.conv1.weight)


def test_a_negative_seed_is_refused():
    with pytest.raises(UserError, match="seed must be at least 0, got -1"):
        derive_seed(-1, "weights")
