import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("sb3_contrib")

from sb3_contrib import RecurrentPPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from knowarm.learn.sb3_vec_env import SB3VecEnv
from knowarm.world.config import EnvConfig
from knowarm.world.envs.single_env import ArmEnv
from knowarm.world.envs.vector_env import ArmVectorEnv

TABLE = np.random.default_rng(0).standard_normal((3, 5)).astype(np.float32)
SHOWN = {"observe": ("image", "knowledge"), "knowledge": TABLE}
SHORT = {"dynamics": "kinematic", "max_episode_steps": 6}


def vectorized(n=4):
    return SB3VecEnv(ArmVectorEnv(EnvConfig(**SHORT), n, **SHOWN), seed=7)


def test_ends_of_episodes_are_marked_as_stable_baselines_wants_them():
    env, plain = vectorized(), ArmVectorEnv(EnvConfig(**SHORT), 4)
    observation = env.reset()
    expected, _ = plain.reset(seed=7)
    np.testing.assert_array_equal(observation["image"], expected)
    np.testing.assert_array_equal(
        observation["knowledge"], TABLE[plain.knowledge_input]
    )
    still = np.zeros((4, 6), np.int64)
    for _ in range(5):
        _, _, done, infos = env.step(still)
        before, *_ = plain.step(still)
        assert not done.any()
        assert infos == [{}] * 4
    facets = plain.knowledge_input
    _, rewards, done, infos = env.step(still)
    _, _, _, _, plain_infos = plain.step(still)
    assert done.all()
    assert rewards.dtype == np.float32
    for i, info in enumerate(infos):
        assert info["TimeLimit.truncated"]
        assert not info["is_success"]
        last = info["terminal_observation"]
        np.testing.assert_array_equal(last["image"], plain_infos["final_obs"][i])
        np.testing.assert_array_equal(last["knowledge"], TABLE[facets[i]])
    assert not np.array_equal(infos[0]["terminal_observation"]["image"], before[1])


def test_a_later_seed_is_of_the_next_reset_alone():
    env, plain = vectorized(), ArmVectorEnv(EnvConfig(**SHORT), 4)
    env.seed(3)  # as an algorithm of Stable-Baselines3 does with its own seed
    np.testing.assert_array_equal(env.reset()["image"], plain.reset(seed=3)[0])
    np.testing.assert_array_equal(env.reset()["image"], plain.reset()[0])


@pytest.mark.filterwarnings("error")
def test_policies_are_evaluated_without_another_wrapper():
    class Still:
        def predict(self, observation, **_):
            return np.zeros((4, 6), np.int64), None

    _, lengths = evaluate_policy(Still(), vectorized(), 4, return_episode_rewards=True)
    assert lengths == [6] * 4
    assert vectorized().env_is_wrapped(VecMonitor) == [False] * 4


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["vectorized", "single"])
def test_multi_input_lstm_policy_trains_unchanged(kind):
    if kind == "vectorized":
        env = vectorized()
    else:
        env = DummyVecEnv([lambda: ArmEnv(**SHORT, **SHOWN)] * 2)
    model = RecurrentPPO(
        "MultiInputLstmPolicy", env, n_steps=8, batch_size=16, n_epochs=1, device="cpu"
    )
    before = [p.detach().clone() for p in model.policy.parameters()]
    model.learn(32)
    assert model.num_timesteps >= 32
    changed = [
        not np.array_equal(b, p.detach())
        for b, p in zip(before, model.policy.parameters(), strict=True)
    ]
    assert all(changed)


@pytest.mark.parametrize("wrap", [VecMonitor, lambda env: env])
def test_return_and_length_of_episodes_are_logged(wrap):
    env = wrap(vectorized())
    env.reset()
    steps = [env.step(np.zeros((4, 6), np.int64)) for _ in range(6)]
    returns = sum(rewards for _, rewards, _, _ in steps)
    episodes = [info["episode"] for info in steps[-1][3]]
    assert [each["l"] for each in episodes] == [6] * 4
    np.testing.assert_allclose([each["r"] for each in episodes], returns, rtol=1e-5)


def test_without_its_package_it_says_which_extra_to_install():
    code = (
        "import sys\nsys.modules['stable_baselines3'] = None\nimport knowarm\n"
        "try: knowarm.SB3VecEnv\nexcept knowarm.UserError as error: print(error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    start, end = done.stdout.strip().split("(stable_baselines3.common")
    assert start == "SB3VecEnv needs a package that is not installed "
    assert end.endswith("): pip install 'knowarm[sb3]'.")
