"""Registered algorithms: the numbers that the paper states, and what stored runs meant."""

import pytest

from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.experiment.csv_log import read_csv
from knowarm.experiment.load import load_agent
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run import train
from knowarm.learn.a3c.update import RMSPROP_ALPHA
from knowarm.learn.algorithms import privileged_uses
from knowarm.reading import read_json, write_json


def test_a3c_has_the_papers_numbers_and_follows_its_lineage_where_the_paper_is_silent():
    config = experiment_config("irb120-full-a3c")
    a3c = config.algorithm
    assert (a3c.workers, a3c.envs_per_worker) == (17, 1)
    assert a3c.is_fixed
    assert not experiment_config("irb120-full-a3c-tuned").algorithm.is_fixed
    assert (a3c.learning_rate, RMSPROP_ALPHA) == (1e-4, 0.99)
    assert (a3c.gamma, a3c.gae_lambda) == (0.99, 1.0)
    assert (a3c.ent_coef, a3c.vf_coef) == (0.01, 1.0)
    assert (a3c.reward_scale, a3c.matmul_precision) == (1.0, "float32")
    assert config.total_steps == 70_000_000
    assert (config.interim.every_steps, config.interim.episodes) == (50_000, 40)
    assert (a3c.rmsprop_eps, a3c.max_grad_norm, a3c.rollout_steps) == (1e-8, 40, 50)
    assert (a3c.rollout_ends_with_episode, a3c.bootstrap_at_time_limit) == (True, False)
    assert (config.policy.fc_activation, config.policy.pixel_shift) == ("none", 0)
    assert config.policy.actor_gain == 1


def test_only_a3c_starts_with_large_actor_heads():
    gains = {
        name: experiment_config(f"irb120-bm-{name}").policy.actor_gain
        for name, algorithm in ALGORITHMS.items()
        if not algorithm.needs_grounding
    }
    assert {name for name, gain in gains.items() if gain != 0.01} == {"a3c"}


def test_a_run_from_before_the_actor_gain_resumes_with_its_gain(tmp_path):
    config = experiment_config(
        "irb120-bm-a3c",
        total_steps=200,
        policy={"actor_gain": 0.01},
        algorithm={"workers": 2, "log_every_steps": 50},
        interim={"every_steps": 100, "episodes": 1},
    )
    folder = train(config, tmp_path, until_step=1).folder
    assert "actor_gain" not in (folder.checkpoints / "latest" / "meta.json").read_text()
    config_file, provenance_file = folder.config_path, folder.path / "provenance.json"
    values = read_json(config_file)
    del values["policy"]["actor_gain"]
    write_json(config_file, values)
    values = read_json(provenance_file)
    del values["policy"]["config"]["actor_gain"]
    write_json(provenance_file, values)
    again = train(folder.experiment(), tmp_path, resume=True)
    assert again.result.reason == "finished"
    assert load_agent(folder.path, which="untrained").policy.config.actor_gain == 0.01
    with pytest.raises(UserError, match=r"policy.actor_gain: 0.01 \| 1.0"):
        train("irb120-bm-a3c", tmp_path, resume=True)


def test_imitation_gives_the_goal_to_the_layer_of_the_auxiliary_loss():
    """The settings of docs/results/answers.md; agents without a grounding network keep theirs."""
    fusion = {
        name: experiment_config(f"irb120-choose-{name}").policy.fusion
        for name in (
            "answers-distil",
            "mask-distil",
            "answers-fast",
            "subgraph-similarity-distil",
        )
    }
    assert [*fusion.values()] == ["before_fc", "before_fc", "before_lstm", "similarity"]
    assert experiment_config("irb120-choose-answers-distil").total_steps == 300_000
    assert experiment_config("irb120-full-distil").total_steps == 200_000


def test_plain_ppo_uses_no_privileged_state():
    config = experiment_config("irb120-full-ppo").algorithm
    assert privileged_uses(to_dict(config)) == []
    assert (config.optimizer, config.privileged.threshold_factor) == ("adam", 1.0)


def test_a3c_is_trained_on_the_fixed_schedule(tmp_path):
    run = train(
        "irb120-bm-a3c",
        tmp_path,
        total_steps=100,
        algorithm={"workers": 2},
        interim={"every_steps": 100, "episodes": 1},
    )
    (row,) = read_csv(run.folder.metrics_path)
    assert row["updates"] == "2"
    assert "worker_0_steps" not in row  # of the asynchronous processes
