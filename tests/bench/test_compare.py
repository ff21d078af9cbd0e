"""Tests of the comparisons with other libraries in ``benchmarks/``."""

import dataclasses

import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run import build
from knowarm.learn import PPOConfig
from knowarm.world.config import EnvConfig
from knowarm.world.envs.vector_env import ArmVectorEnv


def test_a_recurrent_policy_of_sb3_has_as_many_parameters() -> None:
    pytest.importorskip("sb3_contrib")
    from benchmarks.compare_learn import parameter_count, recurrent_ppo
    from knowarm.learn.sb3_vec_env import SB3VecEnv

    chosen = experiment_config("irb120-full-ppo")
    parts = build(chosen)
    shown = {"observe": ("image", "knowledge"), "knowledge": parts.knowledge.table}
    env = SB3VecEnv(ArmVectorEnv(chosen.env, 4, **shown))
    config = PPOConfig(num_envs=4, minibatches=2)
    model = recurrent_ppo(parts.new_policy(0), config, env, seed=0)
    counts = parts.new_policy(0).parameter_counts()
    assert parameter_count(model) == counts["total"]
    assert (
        sum(p.numel() for p in model.policy.lstm_actor.parameters()) == counts["memory"]
    )
    assert (model.n_steps * env.num_envs) // model.batch_size == config.minibatches
    assert model.n_epochs == config.epochs


@pytest.mark.slow
def test_learners_are_compared_in_one_table(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("sb3_contrib")
    from benchmarks.compare_learn import CompareLearnConfig, compare_learn

    ppo = CompareLearnConfig().ppo()
    small = dataclasses.replace(ppo, num_envs=8, minibatches=2)
    monkeypatch.setattr(CompareLearnConfig, "ppo", lambda *names: small)
    # They are measured as in `benchmarks/learn.py`.
    a3c = [{"name": name, "steps_per_s": 1.0} for name in ("a3c", "a3c-batched")]
    monkeypatch.setattr("benchmarks.compare_learn.a3c_rows", lambda config: a3c)
    result = compare_learn(
        CompareLearnConfig(cores=1, seconds=0.1, turns=1, opengl=False)
    )
    rows = {row["name"]: row for row in result["rows"]}
    assert set(rows) == {"raycaster", "ppo", "a3c", "a3c-batched", "sb3"}
    assert (
        result["ratio_vs_sb3"]
        == rows["ppo"]["steps_per_s"] / rows["sb3"]["steps_per_s"]
    )
    assert result["ratio_best_vs_sb3"] >= result["ratio_vs_sb3"]
    assert result["ratio_vs_sb3_opengl"] is None


@pytest.mark.slow
def test_simulations_are_compared_in_one_table(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco_warp")
    from benchmarks import compare_world as module
    from benchmarks import world
    from benchmarks.compare_world import CompareWorldConfig, compare_world

    every = world.env_configs
    for each in (module, world):  # the first of three tasks
        monkeypatch.setattr(each, "env_configs", lambda config: every(config)[:1])
    sizes = {
        "num_envs": 4,
        "workers": 1,
        "seconds": 0.05,
        "robots": ("irb120",),
        "image_size": 16,
    }
    result = compare_world(CompareWorldConfig(opengl=False, **sizes))
    for row in result["rows"]:
        assert row["ratio_vs_mjwarp"] == row["steps_per_s"] / row["mjwarp_steps_per_s"]
        assert "ratio_vs_opengl" not in row


def test_environments_must_be_divisible_by_workers() -> None:
    from benchmarks.compare_world import CompareWorldConfig

    with pytest.raises(
        UserError, match=r"num_envs \(5\) must be a multiple of workers \(2\)"
    ):
        CompareWorldConfig(num_envs=5)


@pytest.mark.slow
def test_mujoco_warp_renders_the_same_scene() -> None:
    pytest.importorskip("mujoco_warp")
    from benchmarks.compare_world import MjWarpRenderer

    env = ArmVectorEnv(EnvConfig(antialiasing=False), 3)
    expected, _ = env.reset(seed=2)
    env.renderer = MjWarpRenderer(env.scene, 64, 3)
    found, _ = env.reset(seed=2)
    assert np.abs(expected.astype(int) - found).mean() < 6
    assert (np.abs(expected.astype(int) - found).max(axis=-1) > 60).mean() < 0.03
