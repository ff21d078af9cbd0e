"""A3C on a fixed schedule: gradients of each worker, order of the updates, resuming."""

import dataclasses
from functools import partial

import numpy as np
import pytest
import torch

from knowarm.errors import UserError
from knowarm.learn import FixedScheduleA3CTrainer, NumpyToTorch
from knowarm.learn.a3c.fixed_schedule import first_episodes
from knowarm.learn.a3c.gradients import WorkerGradients
from knowarm.learn.a3c.update import rmsprop_update, rmsprop_updates, rollout_loss
from knowarm.learn.algorithms import A3CConfig
from knowarm.learn.checkpoint import CheckpointStore, read_checkpoint
from knowarm.learn.rollout import Collector
from knowarm.policy import Policy, PolicyConfig
from knowarm.policy.config import FUSIONS
from tests.learn.toys import SHAPE, ToyEnv, recorder, success_rate, toy_env, toy_policy

WORKERS, LENGTH, WIDTH = 3, 5, 6
CONFIG = A3CConfig(
    schedule="fixed",
    workers=WORKERS,
    rollout_steps=LENGTH,
    ent_coef=0.1,
    log_every_steps=60,
)
TABLE = np.random.default_rng(5).standard_normal((4, WIDTH)).astype(np.float32)


def played(policy, env, steps=LENGTH):
    """Let workers play until each has ended an episode; return their gradients and the rollout."""
    workers = WorkerGradients(policy, steps, env.num_envs)
    collector = Collector(env, policy, seed=3)
    count = collector.collect(workers.rollout, workers.infer, until_episode_end=True)
    return workers, workers.rollout.first(count), count


@pytest.mark.parametrize("encoder", ["none", "learned"])
@pytest.mark.parametrize("fusion", FUSIONS)
def test_the_gradient_of_each_worker_is_that_of_its_own_loss(fusion, encoder):
    known = 0 if fusion == "none" else WIDTH
    shape = dataclasses.replace(
        SHAPE, knowledge_dim=known, knowledge_slots=2 if known else 1
    )
    changes = {"knowledge_encoder": encoder} if known and encoder != "none" else {}
    changes |= {"pixel_shift": 0.4, "actor_gain": 1.0}
    policy = Policy(PolicyConfig(features=16, fusion=fusion, **changes), shape)
    table = TABLE[:, :known] if known else None
    env = toy_env(WORKERS, table, recall=True, length=LENGTH, staggered=True, facets=4)
    workers, rollout, count = played(policy, env)
    used = first_episodes(rollout.done)
    lengths = used.sum(0)
    assert sorted(lengths.tolist()) == [3, 4, 5]
    workers.compute(
        count,
        lambda encoded: rollout_loss(
            policy, CONFIG, rollout, encoded=encoded, weights=used / lengths
        ),
    )
    assert set(workers.gradients) == {name for name, _ in policy.named_parameters()}
    for worker in range(WORKERS):
        policy.zero_grad()
        own = rollout.of(torch.tensor([worker])).first(int(lengths[worker]))
        rollout_loss(policy, CONFIG, own)["total"].backward()
        for name, parameter in policy.named_parameters():
            gradient = workers.gradients[name][worker]
            torch.testing.assert_close(
                gradient, parameter.grad, rtol=1e-4, atol=1e-6, msg=name
            )


def test_gradients_of_rollouts_that_span_the_ends_of_episodes():
    policy = toy_policy(actor_gain=1.0)
    env = toy_env(WORKERS, recall=True, length=LENGTH, staggered=True)
    workers = WorkerGradients(policy, LENGTH + 3, WORKERS)
    collector = Collector(env, policy, seed=3)
    for _ in range(2):  # the second one begins within episodes
        count = collector.collect(workers.rollout, workers.infer)
    rollout, weights = workers.rollout, torch.full((count, WORKERS), 1 / count)
    assert rollout.start_h.abs().sum() > 0
    assert rollout.episode_start[1:].any()
    workers.compute(
        count,
        lambda encoded: rollout_loss(
            policy, CONFIG, rollout, encoded=encoded, weights=weights
        ),
    )
    rollout_loss(policy, CONFIG, rollout)["total"].backward()
    for name, parameter in policy.named_parameters():
        mean = workers.gradients[name].mean(0)
        torch.testing.assert_close(mean, parameter.grad, rtol=1e-4, atol=1e-6, msg=name)


def test_updates_are_steps_of_rmsprop_in_the_order_given():
    rng = np.random.default_rng(0)
    gradients = rng.standard_normal((3, 10_000)).astype(np.float32)
    values, mean_square = (rng.random(10_000).astype(np.float32) for _ in range(2))
    x, m = (torch.from_numpy(each.copy()) for each in (values, mean_square))
    order, factors = np.array([2, 0, 1]), np.array([1.0, 0.5, 0.25], np.float32)
    rates = np.array([1e-3, 2e-3, 3e-3], np.float32)
    rmsprop_updates(
        values, mean_square, gradients, order, factors, rates, np.float32(1e-8)
    )
    for k in order:
        scaled = torch.from_numpy(gradients[k] * factors[k])
        rmsprop_update(x, m, scaled, learning_rate=float(rates[k]), eps=1e-8)
    np.testing.assert_allclose(values, x, rtol=1e-5)
    np.testing.assert_allclose(mean_square, m, rtol=1e-5)


def make_env(num_envs, num_threads, *, recall=True, length=LENGTH, staggered=True):
    assert num_threads == 1
    return NumpyToTorch(
        ToyEnv(num_envs, recall=recall, length=length, staggered=staggered)
    )


def trainer(folder=None, config=CONFIG, make=make_env, **hooks):
    seen = recorder(**hooks)
    built = FixedScheduleA3CTrainer(
        config,
        toy_policy(),
        make,
        seed=3,
        hooks=seen.hooks,
        checkpoints=CheckpointStore(folder, {"policy": "small"}) if folder else None,
        checkpoint_every=100,
    )
    return built, seen.rows


def test_only_steps_of_the_workers_own_episodes_count():
    built, rows = trainer()
    before = built.policy.actor.weight.detach().clone()
    built.train(60)
    # The first episodes have 3, 4 and 5 steps, and so have those that start together later.
    assert built.step == 5 * 12
    assert rows[0]["updates"] == rows[0]["episodes"] == 15
    assert rows[0]["length_mean"] == 4
    assert not torch.equal(built.policy.actor.weight, before)


def test_the_shortest_rollout_updates_first_each_clipped_by_itself():
    config = dataclasses.replace(CONFIG, max_grad_norm=0.1)
    built, rows = trainer(config=config)
    values = torch.cat([each.detach().flatten() for each in built.policy.parameters()])
    mean_square = torch.zeros_like(values)
    built.train(12)  # one round
    assert rows[0]["grad_norm"] > config.max_grad_norm
    names = [name for name, _ in built.policy.named_parameters()]
    for worker in (2, 1, 0):  # their first episodes have 3, 4 and 5 steps
        gradient = torch.cat(
            [built._workers.gradients[name][worker].flatten() for name in names]
        )
        gradient *= (config.max_grad_norm / gradient.norm()).clamp(max=1)
        rmsprop_update(values, mean_square, gradient, learning_rate=1e-4, eps=1e-8)
    after = torch.cat([each.detach().flatten() for each in built.policy.parameters()])
    torch.testing.assert_close(after, values, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("whole", [True, False])
def test_a_stopped_and_resumed_training_equals_an_uninterrupted_one(tmp_path, whole):
    config = dataclasses.replace(
        CONFIG, rollout_ends_with_episode=whole, rollout_steps=6
    )
    complete, rows = trainer(tmp_path / "complete", config)
    complete.train(500)
    cut, first = trainer(tmp_path / "cut", config, should_stop=lambda: len(first) >= 3)
    assert cut.train(500).reason == "stopped"
    resumed, second = trainer(tmp_path / "cut", config)
    resumed.resume()
    resumed.train(500)
    timing = {"wall_time_s", "steps_per_s"}
    assert [{**row, **dict.fromkeys(timing)} for row in first + second] == [
        {**row, **dict.fromkeys(timing)} for row in rows
    ]
    for file in ("policy", "optimizer", "state"):
        name = f"latest/{file}.safetensors"
        files = [tmp_path / folder / name for folder in ("complete", "cut")]
        assert files[0].read_bytes() == files[1].read_bytes()


def test_a_checkpoint_between_episodes_holds_no_environments(tmp_path):
    whole, _ = trainer(tmp_path / "whole")
    whole.train(100)
    spanning, _ = trainer(
        tmp_path / "spanning",
        dataclasses.replace(CONFIG, rollout_ends_with_episode=False),
    )
    spanning.train(100)
    names = {
        name: {*read_checkpoint(tmp_path / name / "latest").state}
        for name in ("whole", "spanning")
    }
    assert names["whole"] == {"generator"}
    assert names["spanning"] > {"generator", "observation", "env/clock"}


def test_rounds_draw_other_episodes_each_time():
    seeds = []

    class Recorded(ToyEnv):
        def reset(self, *, seed=None, options=None):
            seeds.append(seed)
            return super().reset(seed=seed, options=options)

    def make(num_envs, num_threads):
        return NumpyToTorch(Recorded(num_envs, recall=True, length=LENGTH))

    trainer(make=make)[0].train(60)
    assert None not in seeds
    assert len(seeds) == len({*seeds}) == 1 + 60 // (WORKERS * LENGTH)


def test_rollouts_that_do_not_reach_the_end_of_an_episode_are_refused():
    built, _ = trainer(config=dataclasses.replace(CONFIG, rollout_steps=LENGTH - 1))
    with pytest.raises(
        UserError, match="rollout_steps is 4, and an episode has not ended"
    ):
        built.train(100)
    other = dataclasses.replace(
        CONFIG, rollout_steps=4, rollout_ends_with_episode=False
    )
    assert trainer(config=other)[0].train(100).step >= 100


@pytest.mark.slow
def test_the_memory_task_is_solved():
    config = dataclasses.replace(
        CONFIG,
        workers=17,
        learning_rate=1e-3,
        rollout_steps=2,
        vf_coef=0.5,
        rmsprop_eps=1e-5,
    )
    built, _ = trainer(config=config, make=partial(make_env, length=2, staggered=False))
    built.train(9_000)
    assert success_rate(built.policy, recall=True, length=2) > 0.75
