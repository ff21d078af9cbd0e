"""Small vector environments and helpers of the learning tests."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import torch

from knowarm.learn import Hooks, NumpyToTorch
from knowarm.learn.learner import Learner, TrainingNetwork
from knowarm.learn.ppo import minibatch_loss
from knowarm.policy import Policy, PolicyAgent, PolicyConfig, PolicyShape

JOINTS, LEVELS, SIDE = 2, 3, 20
SHAPE = PolicyShape(joints=JOINTS, levels=LEVELS, image_size=SIDE)


class ToyEnv:
    """Each joint must choose the level that its half of the image shows as a shade of grey.

    Weak noise makes every image another one, final observations included. It does not depend on
    the actions.

    Identity task (``recall=False``): a new image and a reward every step, truncated after
    ``length`` steps. Memory task (``recall=True``): the image is black after the first step and
    only the last action is rewarded; the episode then terminates.

    Args:
        staggered: environments end their first episodes at different steps.
        facets: number of facets, one drawn per episode; with 1 they stay as they are.
    """

    def __init__(self, num_envs, *, recall, length, staggered=False, facets=1):
        self.num_envs, self.recall, self.length = num_envs, recall, length
        self.staggered, self.facets = staggered, facets
        self.knowledge_input = np.zeros(num_envs, np.int64)

    def reset(self, *, seed=None, options=None):
        if seed is not None:
            self._seed, self._draws = seed, np.zeros((), np.int64)
        self._clock = np.zeros(self.num_envs, np.int64)
        if self.staggered:
            self._clock = np.arange(self.num_envs) % self.length
        self._cue = self._draw()
        self._draw_facets(np.ones(self.num_envs, np.bool_))
        return self._look(), {}

    def step(self, actions):
        right = (actions == self._cue).mean(1)
        self._clock += 1
        done = self._clock == self.length
        if not self.recall:
            self._cue = self._draw()
        before = self._look(final=True)
        reward = np.where(done, right, 0.0) if self.recall else right
        self._cue = np.where(done[:, None], self._draw(), self._cue)
        self._draw_facets(done)
        self._clock[done] = 0
        none = np.zeros_like(done)
        success = right == 1
        infos = {"final_obs": before, "final_info": {"is_success": success}}
        terminated, truncated = (done, none) if self.recall else (none, done)
        return self._look(), reward, terminated, truncated, infos

    def get_state(self):
        return {
            "clock": self._clock.copy(),
            "cue": self._cue.copy(),
            "draws": np.array(self._draws),
            "seed": np.array(self._seed),
            "facets": np.array(self.knowledge_input),
        }

    def set_state(self, state):
        self._clock, self._cue = state["clock"].copy(), state["cue"].copy()
        self._draws, self._seed = np.array(state["draws"]), int(state["seed"])
        self.knowledge_input = state["facets"].copy()

    def _draw(self):
        self._draws = self._draws + 1
        random = np.random.default_rng((self._seed, int(self._draws)))
        return random.integers(0, LEVELS, (self.num_envs, JOINTS))

    def _draw_facets(self, where):
        if self.facets > 1:
            random = np.random.default_rng((self._seed, int(self._draws), 1))
            drawn = random.integers(0, self.facets, self.num_envs)
            self.knowledge_input = np.where(where, drawn, self.knowledge_input)

    def _look(self, final=False):
        image = np.zeros((self.num_envs, SIDE, SIDE, 3), np.uint8)
        if self.recall:
            shade = np.where(self._clock[:, None] == 0, 60 + 90 * self._cue, 0)
        else:
            shade = 60 + 90 * self._cue
        half = SIDE // 2
        image[:, :, :half] = shade[:, 0, None, None, None]
        image[:, :, half:] = shade[:, 1, None, None, None]
        noise = np.random.default_rng((self._seed, int(self._draws), 2 + final))
        return image + noise.integers(0, 6, image.shape, np.uint8)


def toy_env(num_envs, table=None, **options):
    """Create a toy environment as the learner expects it, with a knowledge table (F, K)."""
    return NumpyToTorch(ToyEnv(num_envs, **options), table)


def toy_policy(*, features=32, pixel_shift=0.4, actor_gain=0.01, seed=0):
    """Create a small policy without knowledge."""
    config = PolicyConfig(
        features=features, fusion="none", pixel_shift=pixel_shift, actor_gain=actor_gain
    )
    return Policy(config, SHAPE, seed=seed)


def informed_toy_policy(width, *, seed=1):
    """Create a small policy with knowledge of some width and visible actor outputs."""
    shape = PolicyShape(
        joints=JOINTS, levels=LEVELS, image_size=SIDE, knowledge_dim=width
    )
    return Policy(PolicyConfig(features=16, actor_gain=1.0), shape, seed=seed)


def success_rate(policy, *, recall, length):
    """Return the fraction of episodes that end with the right action, played greedily."""
    env = ToyEnv(100, recall=recall, length=length)
    agent = PolicyAgent(policy, greedy=True)
    observation, _ = env.reset(seed=99)
    agent.reset(SimpleNamespace(rows=env.knowledge_input))
    for _ in range(length):
        observation, _, _, _, infos = env.step(agent.act({"image": observation}))
    return infos["final_info"]["is_success"].mean()


def noisy_learner(config, *, auxiliary=0, device="cpu"):
    """Create a learner of PPO whose rollout and targets hold made-up numbers."""
    rng = np.random.default_rng(0)
    known = rng.standard_normal((3, 4)).astype(np.float32)
    policy = informed_toy_policy(4)
    table = ((config.rollout_steps, config.num_envs), torch.float32)
    learner = Learner(
        TrainingNetwork(policy, auxiliary, seed=3),
        config,
        partial(minibatch_loss, config),
        {"advantage": table, "returns": table},
        "float32",
        torch.device(device),
    )
    rollout, targets = learner.rollout, learner.targets
    rollout.patches.copy_(
        torch.from_numpy(rng.integers(0, 256, rollout.patches.shape, np.uint8))
    )
    rollout.knowledge.copy_(
        torch.from_numpy(known[rng.integers(0, 3, rollout.reward.shape)])
    )
    rollout.episode_start.copy_(
        torch.from_numpy(rng.random(rollout.reward.shape) < 0.2)
    )
    rollout.action.copy_(
        torch.from_numpy(rng.integers(0, LEVELS, rollout.action.shape))
    )
    floats = (
        rollout.log_probability,
        rollout.start_h,
        rollout.start_c,
        *targets.values(),
    )
    for tensor in floats:
        tensor.copy_(torch.from_numpy(rng.standard_normal(tensor.shape)))
    return learner


def recorder(**options):
    """Return hooks and the rows of metrics and evaluations that they collect."""
    rows, evaluations = [], []
    hooks = Hooks(
        on_metrics=rows.append,
        on_evaluation=lambda *result: evaluations.append(result),
        **options,
    )
    return SimpleNamespace(hooks=hooks, rows=rows, evaluations=evaluations)
