"""The adapter gives Gymnasium's NumPy vector environments the learner's interface."""

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from knowarm.errors import UserError
from knowarm.learn import NumpyToTorch, PPOTrainer
from knowarm.learn.algorithms import PPOConfig, PrivilegedConfig
from tests.learn.toys import JOINTS, LEVELS, SIDE, toy_env, toy_policy

LARGER = PrivilegedConfig(threshold_factor=3.0)


class SingleEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """A user's environment without facets, state or ``is_success``; truncated after 3 steps."""

    observation_space = spaces.Box(0, 255, (SIDE, SIDE, 3), np.uint8)
    action_space = spaces.MultiDiscrete([LEVELS] * JOINTS)

    def _image(self) -> np.ndarray:
        return np.full((SIDE, SIDE, 3), self.clock, np.uint8)

    def reset(self, **options: Any):
        self.clock = 0
        return self._image(), {}

    def step(self, action):
        self.clock += 1
        return self._image(), 1.0, False, self.clock == 3, {}


def vector(mode=AutoresetMode.SAME_STEP):
    return SyncVectorEnv([SingleEnv] * 8, autoreset_mode=mode)


def test_an_ordinary_gymnasium_vector_environment_is_adapted():
    env = NumpyToTorch(vector())
    image, _ = env.reset(seed=0)
    assert (image.dtype, image.shape) == (torch.uint8, (8, SIDE, SIDE, 3))
    assert env.knowledge.shape == (8, 0)
    assert NumpyToTorch(vector(), np.ones((1, 3))).knowledge.tolist() == [[1.0] * 3] * 8
    for step in (1, 2, 3):
        image, reward, terminated, truncated, infos = env.step(
            torch.zeros(8, JOINTS, dtype=int)
        )
        assert reward.tolist() == [1.0] * 8
        assert not terminated.any()
        assert truncated.all() == (step == 3)
        assert ("final_obs" in infos) == (step == 3)
    assert (infos["final_obs"] == 3).all()
    assert (image == 0).all()


def test_ppo_trains_on_it_without_checkpoints():
    config = PPOConfig(num_envs=8, rollout_steps=4, minibatches=2, processes=1)
    trainer = PPOTrainer(
        config, toy_policy(features=16), NumpyToTorch(vector()), seed=0
    )
    assert trainer.train(64).step == 64
    with pytest.raises(UserError, match="SyncVectorEnv has no get_state and set_state"):
        trainer._collector.env.get_state()


def test_a_threshold_factor_of_the_environment_is_found_behind_the_adapter():
    config = PPOConfig(num_envs=8, minibatches=2, processes=1, privileged=LARGER)
    env = vector()
    with pytest.raises(UserError, match="SyncVectorEnv has no threshold_factor"):
        PPOTrainer(config, toy_policy(features=16), NumpyToTorch(env), seed=0)
    env.threshold_factor = 1.0
    PPOTrainer(config, toy_policy(features=16), NumpyToTorch(env), seed=0)
    assert env.threshold_factor == 3.0


def test_another_autoreset_mode_is_rejected():
    with pytest.raises(UserError, match="'NextStep'; training needs SAME_STEP"):
        NumpyToTorch(vector(AutoresetMode.NEXT_STEP))


def test_only_truncated_rows_hold_final_observations():
    env = toy_env(4, recall=False, length=5, staggered=True)
    env.reset(seed=0)
    *_, truncated, infos = env.step(torch.zeros(4, JOINTS, dtype=torch.int64))
    assert not truncated.any()
    assert "final_obs" not in infos
    *_, truncated, infos = env.step(torch.zeros(4, JOINTS, dtype=torch.int64))
    assert truncated.tolist() == [False, False, False, True]
    assert infos["final_obs"][3].any()
    assert not infos["final_obs"][:3].any()
    assert infos["final_info"]["is_success"].dtype == torch.bool
