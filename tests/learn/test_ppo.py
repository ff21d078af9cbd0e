import dataclasses

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from knowarm.errors import UserError
from knowarm.learn.checkpoint import CheckpointStore
from knowarm.learn.config import PPOConfig
from knowarm.learn.guards import NotFiniteError
from knowarm.learn.ppo import PPOTrainer
from knowarm.learn.trainer import Hooks
from knowarm.policy import Policy, PolicyAgent, PolicyConfig
from tests.learn.toys import JOINTS, LEVELS, SIDE, ToyEnv

TABLE = np.zeros((1, 1), np.float32)
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


def small_policy():
    return Policy(
        PolicyConfig(
            joints=JOINTS,
            levels=LEVELS,
            image_size=SIDE,
            features=32,
            fusion="none",
            pixel_shift=0.4,
        )
    )


def successes(policy, *, recall, length):
    """Share of episodes that end with the right action, played greedily."""
    env = ToyEnv(100, recall=recall, length=length)
    agent = PolicyAgent(policy, TABLE, greedy=True)
    observation, _ = env.reset(seed=99)
    agent.start(env)
    for _ in range(length):
        observation, _, _, _, infos = env.step(agent.act(observation))
    return infos["final_info"]["is_success"].mean()


def test_identity_task_is_solved():
    policy = small_policy()
    config = dataclasses.replace(SMALL, gamma=0.5)  # images do not depend on actions
    PPOTrainer(config, policy, ToyEnv(32, recall=False, length=5), TABLE, seed=0).train(10_000)
    assert successes(policy, recall=False, length=5) > 0.95


def test_memory_task_is_solved():
    """Rollouts of 10 steps hold episodes of 3: most rollouts start in the middle of one."""
    policy = small_policy()
    config = dataclasses.replace(SMALL, num_envs=64, learning_rate=2e-3, gamma=0.9)
    PPOTrainer(config, policy, ToyEnv(64, recall=True, length=3), TABLE, seed=0).train(40_000)
    assert successes(policy, recall=True, length=3) > 0.95


def build(folder, hooks=None, evaluate=None, **changes):
    policy = small_policy()
    store = CheckpointStore(folder, {"network": "small"}) if folder else None
    trainer = PPOTrainer(
        dataclasses.replace(SMALL, **changes),
        policy,
        ToyEnv(32, recall=True, length=7),
        TABLE,
        seed=3,
        hooks=hooks,
        evaluate=evaluate,
        evaluate_every=640,
        checkpoints=store,
        checkpoint_every=640,
    )
    return trainer, policy


def play(policy):
    return {"return_mean": float(successes(policy, recall=True, length=7))}


def test_a_stopped_and_resumed_training_equals_an_uninterrupted_one_to_the_byte(tmp_path):
    def recorder():
        rows, evaluations = [], []
        hooks = Hooks(
            on_metrics=rows.append, on_evaluation=lambda *result: evaluations.append(result)
        )
        return rows, evaluations, hooks

    rows, evaluations, hooks = recorder()
    whole, expected = build(tmp_path / "whole", hooks, play)
    whole.train(3200)

    first, second, hooks = recorder()
    hooks = dataclasses.replace(hooks, should_stop=lambda: len(first) == 4)
    stopped, _ = build(tmp_path / "cut", hooks, play)
    assert stopped.train(3200).reason == "stopped"
    hooks = dataclasses.replace(hooks, should_stop=lambda: False)
    resumed, got = build(tmp_path / "cut", hooks, play)
    resumed.resume()
    result = resumed.train(3200)

    assert result.step == 3200
    assert result.best_step == whole.best.step
    for name, value in expected.state_dict().items():
        assert value.numpy().tobytes() == got.state_dict()[name].numpy().tobytes(), name
    assert second == evaluations
    timing = {"wall_time_s", "steps_per_s", "environment_s", "inference_s", "learn_s"}
    assert [{k: v for k, v in row.items() if k not in timing} for row in first] == [
        {k: v for k, v in row.items() if k not in timing} for row in rows
    ]
    whole_files = sorted((tmp_path / "whole/latest").glob("*.safetensors"))
    assert [f.name for f in whole_files] == [
        "optimizer.safetensors", "policy.safetensors", "state.safetensors",
    ]  # fmt: skip
    for file in whole_files:
        assert file.read_bytes() == (tmp_path / "cut/latest" / file.name).read_bytes(), file.name


def test_the_best_policy_is_kept(tmp_path):
    returns = iter([1.0, 5.0, 3.0, 4.0, 2.0, 2.0])
    seen = []
    hooks = Hooks(on_evaluation=lambda step, _, is_best: seen.append((step, is_best)))
    trainer, _ = build(tmp_path, hooks, lambda _: {"return_mean": next(returns)})
    result = trainer.train(1920)
    assert (result.best_return, result.best_step) == (5.0, 640)
    assert seen == [(0, True), (640, True), (1280, False), (1920, False)]
    best = CheckpointStore(tmp_path, {"network": "small"}).load_best()
    assert best.facts["step"] == 640


def test_the_passes_stop_when_the_policy_moved_too_far():
    rows = []
    trainer, _ = build(None, Hooks(on_metrics=rows.append), target_kl=1e-7)
    trainer.train(320)
    assert rows[0]["gradient_steps"] == 2  # the second minibatch already sees a moved policy


def test_truncation_bootstraps_from_the_final_observation():
    """A critic of 1 everywhere sees 1 after a truncated step and 0 after a terminated one."""
    for recall, expected in ((False, 1.0), (True, 0.0)):
        policy = small_policy()
        with torch.no_grad():
            policy.critic.weight.zero_()
            policy.critic.bias.fill_(1.0)
        trainer = PPOTrainer(SMALL, policy, ToyEnv(32, recall=recall, length=5), TABLE, seed=0)
        rollout = trainer._learner.rollout
        trainer._collector.collect(trainer._learner, rollout)
        assert rollout.done[4].all()
        assert (rollout.final_value[4] == expected).all()


@pytest.mark.parametrize(
    ("spoil", "term"),
    [
        (lambda t: t.policy.critic.weight.data.fill_(float("nan")), "the value"),
        (lambda t: t._collector.table.fill_(float("inf")), "the knowledge"),
    ],
)
def test_a_nan_stops_training_names_the_term_and_saves_the_batch(tmp_path, spoil, term):
    trainer, _ = build(None)
    trainer._guard._folder = tmp_path
    spoil(trainer)
    with pytest.raises(NotFiniteError, match=term) as caught:
        trainer.train(320)
    batch = load_file(caught.value.batch)
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


def test_bad_configs_are_refused():
    with pytest.raises(UserError, match="must divide"):
        PPOConfig(num_envs=10, minibatches=4)
    with pytest.raises(UserError, match="learning_rate must be larger than 0"):
        PPOConfig(learning_rate=0.0)


def test_a_table_with_too_few_rows_is_refused():
    env = ToyEnv(32, recall=True, length=7)
    env.facet_ids = env.facet_ids + 2
    with pytest.raises(UserError, match="1 rows"):
        PPOTrainer(SMALL, small_policy(), env, TABLE, seed=0)
