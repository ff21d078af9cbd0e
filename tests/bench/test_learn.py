import pytest

pytest.importorskip("sb3_contrib")

from knowarm.bench import learn
from knowarm.bench.learn import BenchConfig, bench_learn
from knowarm.bench.sb3_baseline import parameter_count, recurrent_ppo
from knowarm.experiment.build import build
from knowarm.experiment.registry import experiment_config
from knowarm.learn.sb3_vec_env import SB3VecEnv
from knowarm.world.knowledge_observation import VectorKnowledgeObservation
from knowarm.world.vector_env import ReachVectorEnv


def test_the_other_librarys_network_is_as_large_as_ours():
    chosen = experiment_config("irb120-full-ppo")
    parts = build(chosen)
    env = SB3VecEnv(VectorKnowledgeObservation(ReachVectorEnv(chosen.env, 4), parts.table))
    numbers = learn.PPOConfig(num_envs=4, minibatches=2)
    model = recurrent_ppo(parts.policy_config, numbers, env, seed=0)
    ours = parts.new_policy(0).parameter_counts()
    assert parameter_count(model) == ours["total"]
    assert sum(p.numel() for p in model.policy.lstm_actor.parameters()) == ours["memory"]
    assert (model.n_steps * env.num_envs) // model.batch_size == numbers.minibatches
    assert model.n_epochs == numbers.epochs


@pytest.mark.slow
def test_one_table_of_all_learners():
    result = bench_learn(BenchConfig(cores=1, seconds=0.1, turns=1, epochs=1, opengl=False))
    rows = {row["name"]: row for row in result["rows"]}
    assert set(rows) == {"raycaster", "ppo", "a3c", "a3c-batched", "sb3"}
    assert rows["raycaster"]["steps_per_s"] > 100
    assert result["steps_per_s"] == rows["ppo"]["steps_per_s"] > 0
    assert result["ratio_vs_sb3"] == rows["ppo"]["steps_per_s"] / rows["sb3"]["steps_per_s"]
    assert result["ratio_vs_sb3_opengl"] is None
    shares = [value for name, value in rows["ppo"].items() if name.startswith("share")]
    assert len(shares) == 4
    assert 0.8 < sum(shares) <= 1.05
