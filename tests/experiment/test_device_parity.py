"""A trained policy does on the device environment what it does on the array environment."""

from pathlib import Path

import numpy as np
import pytest
import torch

from knowarm.experiment.build import load_agent
from knowarm.world.episodes import evaluation_episodes
from knowarm.world.play import play
from knowarm.world.torch_env import TorchReachVectorEnv
from knowarm.world.vector_env import ReachVectorEnv
from tests.devices import DEVICES

ZOO = Path(__file__).parents[2] / "zoo"
EPISODES = 64


@torch.no_grad()
def outcomes(trained, env, episodes):
    """Return and success of every episode, played greedily on a device environment."""
    policy = trained.policy.to(env.device)
    image, _ = env.reset(options={"episodes": episodes})
    state = policy.initial_state(EPISODES)
    start = torch.ones(EPISODES, dtype=torch.bool, device=env.device)
    running, total = start.clone(), torch.zeros(EPISODES, device=env.device)
    success = torch.zeros_like(start)
    for _ in range(env.config.max_episode_steps):
        logits, _, state = policy.step(image, env.facet_ids, state, start)
        image, reward, terminated, truncated, _ = env.step(logits.argmax(-1))
        start = terminated | truncated
        total += reward * running
        success |= terminated & running
        running &= ~start
    assert not running.any()
    return total.cpu().numpy(), success.cpu().numpy()


@pytest.mark.slow
@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("robot", ["irb120", "tiago"])
def test_a_trained_policy_reaches_the_same_targets(robot, device):
    trained = load_agent(ZOO / f"{robot}-full-ppo")
    env = trained.config.env
    arrays = ReachVectorEnv(env, EPISODES)
    episodes = evaluation_episodes(arrays.scene, env, EPISODES, 5)
    played = play(trained.agent, arrays, episodes)
    total, success = outcomes(
        trained, TorchReachVectorEnv(env, EPISODES, device=device, simulator="warp"), episodes
    )
    assert played.success.mean() > 0.5
    # A pixel or a micrometre may tip a choice between two joint steps, and the rest follows.
    assert (success == played.success).mean() >= 0.95
    same = np.isclose(total, played.episode_return, atol=0.05)
    assert same.mean() >= 0.9
