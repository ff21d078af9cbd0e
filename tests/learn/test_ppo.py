import dataclasses

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from knowarm.errors import UserError
from knowarm.learn.algorithms import PPOConfig
from knowarm.learn.checkpoint import CheckpointStore, read_checkpoint
from knowarm.learn.guards import NotFiniteError
from knowarm.learn.ppo import PPOTrainer
from tests.learn.toys import (
    informed_toy_policy,
    recorder,
    success_rate,
    toy_env,
    toy_policy,
)

SMALL = PPOConfig(
    num_envs=32,
    rollout_steps=10,
    epochs=4,
    minibatches=2,
    learning_rate=3e-3,
    reward_scale=1.0,
    ent_coef=0.01,
    matmul_precision="float32",
    processes=1,
)


def test_identity_task_is_solved():
    policy = toy_policy()
    config = dataclasses.replace(SMALL, gamma=0.5)  # images do not depend on actions
    PPOTrainer(config, policy, toy_env(32, recall=False, length=5), seed=0).train(
        10_000
    )
    assert success_rate(policy, recall=False, length=5) > 0.95


def test_memory_task_is_solved():
    """Rollouts of 10 steps hold episodes of 3: most rollouts start in the middle of one."""
    policy = toy_policy()
    config = dataclasses.replace(SMALL, num_envs=64, learning_rate=2e-3, gamma=0.9)
    PPOTrainer(config, policy, toy_env(64, recall=True, length=3), seed=0).train(40_000)
    # One seed in twenty confuses some images: .75 and .87 were seen, elsewhere 1. The processor's
    # rounding decides which. Without memory a ninth of the episodes succeeds.
    assert success_rate(policy, recall=True, length=3) > 0.7


def build(folder, hooks=None, evaluate=None, **changes):
    policy = toy_policy()
    store = CheckpointStore(folder, {"policy": "small"}) if folder else None
    trainer = PPOTrainer(
        dataclasses.replace(SMALL, **changes),
        policy,
        toy_env(32, recall=True, length=7),
        seed=3,
        hooks=hooks,
        make_evaluate=evaluate and (lambda: evaluate),
        evaluate_every=640,
        checkpoints=store,
        checkpoint_every=640,
    )
    return trainer, policy


def play(policy):
    return {"return_mean": float(success_rate(policy, recall=True, length=7))}


def test_a_stopped_and_resumed_training_equals_an_uninterrupted_one_to_the_byte(
    tmp_path,
):
    expected = recorder()
    whole, expected_policy = build(tmp_path / "whole", expected.hooks, play)
    whole.train(3200)

    first = recorder(should_stop=lambda: len(first.rows) == 4)
    stopped, _ = build(tmp_path / "cut", first.hooks, play)
    assert stopped.train(3200).reason == "stopped"
    second = recorder()
    resumed, policy = build(tmp_path / "cut", second.hooks, play)
    resumed.resume()
    result = resumed.train(3200)

    assert result.step == 3200
    assert result.best_step == whole._best_step
    for name, value in expected_policy.state_dict().items():
        assert value.numpy().tobytes() == policy.state_dict()[name].numpy().tobytes(), (
            name
        )
    assert first.evaluations + second.evaluations == expected.evaluations
    timing = {"wall_time_s", "steps_per_s", "environment_s", "inference_s", "learn_s"}
    assert [
        {k: v for k, v in row.items() if k not in timing}
        for row in first.rows + second.rows
    ] == [{k: v for k, v in row.items() if k not in timing} for row in expected.rows]
    whole_files = sorted((tmp_path / "whole/latest").glob("*.safetensors"))
    assert [f.name for f in whole_files] == [
        "optimizer.safetensors", "policy.safetensors", "state.safetensors",
    ]  # fmt: skip
    for file in whole_files:
        assert (
            file.read_bytes() == (tmp_path / "cut/latest" / file.name).read_bytes()
        ), file.name


def test_the_best_policy_is_kept(tmp_path):
    returns = iter([1.0, 5.0, 3.0, 4.0, 2.0, 2.0])
    seen = recorder()
    trainer, _ = build(tmp_path, seen.hooks, lambda _: {"return_mean": next(returns)})
    result = trainer.train(1920)
    assert (result.best_return, result.best_step) == (5.0, 640)
    assert [(step, is_best) for step, _, is_best in seen.evaluations] == [
        (0, True),
        (640, True),
        (1280, False),
        (1920, False),
    ]
    best = read_checkpoint(tmp_path / "best")
    assert best.facts["step"] == 640


def test_truncation_bootstraps_from_the_final_observation():
    """A critic of 1 everywhere sees 1 after a truncated step and 0 after a terminated one."""
    for recall, expected in ((False, 1.0), (True, 0.0)):
        policy = toy_policy()
        with torch.no_grad():
            policy.critic.weight.zero_()
            policy.critic.bias.fill_(1.0)
        trainer = PPOTrainer(
            SMALL, policy, toy_env(32, recall=recall, length=5), seed=0
        )
        rollout = trainer._learner.rollout
        trainer._collector.collect(rollout)
        assert rollout.done[4].all()
        assert (rollout.final_value[4] == expected).all()


@pytest.mark.parametrize(
    ("term", "number"), [("the value", 0.0), ("the knowledge", np.inf)]
)
def test_a_nan_stops_training_names_the_term_and_saves_the_batch(
    tmp_path, term, number
):
    env = toy_env(32, np.full((1, 4), number, np.float32), recall=True, length=7)
    trainer = PPOTrainer(SMALL, informed_toy_policy(4), env, seed=3)
    trainer._guard._folder = tmp_path
    if term == "the value":
        trainer.policy.critic.weight.data.fill_(float("nan"))
    with pytest.raises(NotFiniteError, match=term):
        trainer.train(320)
    (file,) = tmp_path.glob("not-finite-*.safetensors")
    batch = load_file(file)
    assert batch["patches"].shape == (10, 32, *trainer.policy.encoder.patch_shape)
    assert batch["patches"].any()


def test_a_nan_gradient_names_the_parameter(tmp_path):
    trainer, policy = build(None)
    trainer._guard._folder = tmp_path
    policy.fc.weight.register_hook(lambda gradient: gradient * float("nan"))
    before = {k: v.clone() for k, v in policy.state_dict().items()}
    with pytest.raises(NotFiniteError, match=r"gradient of .*fc.weight"):
        trainer.train(320)
    assert all(torch.equal(v, before[k]) for k, v in policy.state_dict().items())


def test_invalid_configs_are_rejected():
    with pytest.raises(UserError, match="must divide"):
        PPOConfig(num_envs=10, minibatches=4)
    with pytest.raises(UserError, match="learning_rate must be larger than 0"):
        PPOConfig(learning_rate=0.0)


def test_a_table_with_too_few_rows_is_rejected():
    env = toy_env(32, np.zeros((1, 4), np.float32), recall=True, length=7)
    env.env.knowledge_input += 2
    with pytest.raises(
        UserError, match="1 rows and the environment has episodes of row 2"
    ):
        PPOTrainer(SMALL, informed_toy_policy(4), env, seed=0)


def test_an_environment_of_another_size_or_device_is_rejected():
    env = toy_env(8, recall=False, length=5)
    with pytest.raises(UserError, match="num_envs is 32 and the environment has 8"):
        PPOTrainer(SMALL, toy_policy(), env, seed=0)
    config = dataclasses.replace(SMALL, num_envs=8, device="cuda", processes=None)
    with pytest.raises(
        UserError, match="device is 'cuda' and the environment is on cpu"
    ):
        PPOTrainer(config, toy_policy(), env, seed=0)


def test_a_constructor_changes_no_setting_of_the_process(monkeypatch):
    from knowarm.learn import ppo

    kept = []
    monkeypatch.setattr(ppo, "keep_freed_memory", lambda: kept.append(True))
    threads = torch.get_num_threads()
    trainer, _ = build(None)
    assert not kept
    trainer.train(320)
    assert kept
    assert torch.get_num_threads() == threads


@pytest.mark.parametrize(
    ("schedule", "expected"),
    [("constant", [2, 2, 2]), ("linear", [2, 1.1, 0.2]), ("cosine", [2, 1.1, 0.2])],
)
def test_learning_rates(schedule, expected):
    config = PPOConfig(
        learning_rate=2.0, learning_rate_schedule=schedule, learning_rate_final=0.1
    )
    got = [config.learning_rate_at(progress) for progress in (0.0, 0.5, 1.5)]
    assert got == pytest.approx(expected)
