"""Comparison of training speed: KnowArm's PPO and A3C with sb3-contrib's RecurrentPPO.

    pip install 'knowarm[bench]'
    python -m benchmarks.compare_learn --json runs/bench/compare-learn.json

All train the same task with networks, epochs and minibatches of the same size, in one run.
"""

import os
import time
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np
import torch
import tyro
from gymnasium import spaces
from gymnasium.wrappers.vector import TransformReward
from sb3_contrib import RecurrentPPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import SubprocVecEnv, VecEnv
from torch import Tensor, nn

from benchmarks.learn import (
    LearnBenchConfig,
    Row,
    a3c_rows,
    in_turns,
    ppo_row,
    print_learn,
    raycaster_row,
    success_rows,
    summarize_rows,
)
from benchmarks.time_to_success import INTERIM, SuccessClock
from knowarm.cli.tables import check_output, write_json_table
from knowarm.experiment.config import INTERIM_SEED
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run import build
from knowarm.learn import PPOConfig
from knowarm.learn.sb3_vec_env import SB3VecEnv
from knowarm.policy import Policy
from knowarm.world.agents.play import play
from knowarm.world.agents.protocol import Batch, Observations
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.single_env import ArmEnv
from knowarm.world.envs.vector_env import ArmVectorEnv, Observed


@dataclass(frozen=True, kw_only=True)
class CompareLearnConfig(LearnBenchConfig):
    """Settings of the comparison."""

    opengl: bool = True
    """Also train on single environments with MuJoCo's OpenGL renderer (needs EGL or OSMesa)."""

    opengl_envs: int = 8
    """Number of these environments; more do not increase their speed."""


def compare_learn(config: CompareLearnConfig) -> dict[str, Any]:
    """Measure environment steps per second of training for all learners.

    Returns:
        The result of ``bench_learn`` with the rows ``sb3`` and ``sb3-opengl`` added,
        ``ratio_vs_sb3`` (KnowArm's PPO over RecurrentPPO on KnowArm's vector environment),
        ``ratio_best_vs_sb3`` (the learner of KnowArm with the most steps per second over the same)
        and ``ratio_vs_sb3_opengl`` (over RecurrentPPO on single environments; None if left out).
    """
    # The processes of the single environments read it when they start.
    os.environ.setdefault("MUJOCO_GL", "egl")
    torch.set_num_threads(config.cores)
    ppo, sb3 = in_turns(
        [partial(ppo_row, config), partial(sb3_row, config, opengl=False)], config.turns
    )
    learners = [ppo, *a3c_rows(config)]
    rows = [raycaster_row(config), *learners, sb3]
    if config.opengl:
        rows.append(sb3_row(config, opengl=True))
    speed = {row["name"]: row["steps_per_s"] for row in rows}
    success = success_rows(config)
    if success:
        success.append(sb3_success_row(config))
    return summarize_rows(config, rows) | {
        "success": success,
        "ratio_vs_sb3": speed["ppo"] / speed["sb3"],
        "ratio_best_vs_sb3": max(speed[row["name"]] for row in learners) / speed["sb3"],
        "ratio_vs_sb3_opengl": speed["ppo"] / speed["sb3-opengl"]
        if config.opengl
        else None,
    }


SHOWN: tuple[Observed, ...] = ("image", "knowledge")


def sb3_environments(
    config: CompareLearnConfig, env: EnvConfig, table: np.ndarray, ppo: PPOConfig
) -> SB3VecEnv:
    """Return the environment that Stable-Baselines3 learns from, with rewards scaled as ours."""
    threads = config.cores
    vector = ArmVectorEnv(env, ppo.num_envs, threads, observe=SHOWN, knowledge=table)
    return SB3VecEnv(
        TransformReward(vector, lambda r: ppo.reward_scale * r), seed=config.seed
    )


def sb3_row(config: CompareLearnConfig, *, opengl: bool) -> Row:
    """Measure RecurrentPPO on KnowArm's vector environment, or on single ones with OpenGL."""
    chosen, ppo = experiment_config(config.experiment), cast(PPOConfig, config.ppo())
    parts = build(chosen)
    env: VecEnv
    if opengl:
        # A quarter of the rollout, which would take a minute; the cost per step is the same.
        ppo = replace(ppo, num_envs=config.opengl_envs, rollout_steps=100)
        env = single_environments(
            replace(chosen.env, renderer="opengl"),
            parts.knowledge.table,
            config.opengl_envs,
        )
    else:
        env = sb3_environments(config, chosen.env, parts.knowledge.table, ppo)
    clock = RolloutClock(config.seconds)
    model = recurrent_ppo(parts.new_policy(0), ppo, env, seed=config.seed)
    model.learn(10**9, callback=clock)
    env.close()
    (first_step, first_s), (last_step, last_s) = clock.marks[1], clock.marks[-1]
    where = (
        "single environments, MuJoCo's OpenGL"
        if opengl
        else "KnowArm's vector environment"
    )
    return {
        "name": "sb3-opengl" if opengl else "sb3",
        "what": f"sb3-contrib, RecurrentPPO, {where}",
        "envs": ppo.num_envs,
        "steps_per_s": (last_step - first_step) / (last_s - first_s),
        "parameters": parameter_count(model),
        "parameters_knowarm": sum(p.numel() for p in parts.new_policy(0).parameters()),
    }


def sb3_success_row(config: CompareLearnConfig) -> Row:
    """Train RecurrentPPO on KnowArm's vector environment until 80 % success."""
    chosen, ppo = experiment_config(config.experiment), cast(PPOConfig, config.ppo())
    parts = build(chosen)
    env = sb3_environments(config, chosen.env, parts.knowledge.table, ppo)
    model = recurrent_ppo(parts.new_policy(0), ppo, env, seed=config.seed)
    callback = SuccessCallback(chosen.env, parts.knowledge.table, config.success_steps)
    model.learn(10**9, callback=callback)
    return callback.clock.row(
        "sb3", "sb3-contrib, RecurrentPPO, KnowArm's vector environment"
    )


class SB3Agent:
    """Plays episodes with a model of sb3-contrib and keeps its recurrent state."""

    def __init__(self, model: BaseAlgorithm, table: np.ndarray) -> None:
        self._model, self._table = model, table

    def reset(self, batch: Batch) -> None:
        self._knowledge = self._table[batch.rows]
        self._state: tuple[np.ndarray, ...] | None = None
        self._episode_start = np.ones(batch.size, dtype=bool)

    def act(self, observations: Observations) -> np.ndarray:
        """Choose the most probable actions, (n, H, W, 3) uint8 -> (n, J)."""
        actions, self._state = cast(RecurrentPPO, self._model).predict(
            {"image": observations["image"], "knowledge": self._knowledge},
            self._state,
            self._episode_start,
            deterministic=True,
        )
        self._episode_start = np.zeros_like(self._episode_start)
        return actions


class SuccessCallback(BaseCallback):
    """Play the interim evaluation at regular steps and end the training at 80 % success.

    Args:
        config: the task.
        table: (F, K), knowledge of each facet.
        most_steps: environment steps after which to give up.
    """

    def __init__(self, config: EnvConfig, table: np.ndarray, most_steps: int) -> None:
        super().__init__()
        self._env = ArmVectorEnv(config, INTERIM.episodes)
        self._episodes = evaluation_episodes(config, INTERIM.episodes, INTERIM_SEED)
        self._table, self._next = table, 0
        self.clock = SuccessClock(most_steps)

    def _on_rollout_start(self) -> None:
        if self.num_timesteps >= self._next:
            self._next += INTERIM.every_steps
            result = play(SB3Agent(self.model, self._table), self._env, self._episodes)
            self.clock.add(self.num_timesteps, float(result.success.mean()))

    def _on_step(self) -> bool:
        return not self.clock.is_over()


class PaperFeatures(BaseFeaturesExtractor):
    """The paper's image encoder, concatenated with the knowledge: the input of the LSTM."""

    def __init__(self, observation_space: spaces.Dict, features: int) -> None:
        knowledge = int(np.prod(observation_space["knowledge"].shape or (0,)))
        super().__init__(observation_space, features + knowledge)
        self.image = nn.Sequential(
            nn.Conv2d(3, 16, 3, stride=4),
            nn.ReLU(),
            nn.Conv2d(16, 32, 5, stride=2),
            nn.ReLU(),
            nn.Flatten(),
            nn.LazyLinear(features),
            nn.ReLU(),
        )
        self.image(torch.zeros(1, *(observation_space["image"].shape or ())))

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """(N, 3, H, W) scaled to 0..1 and (N, K) -> (N, features + K)."""
        return torch.cat(
            (self.image(observations["image"]), observations["knowledge"]), 1
        )


def recurrent_ppo(
    policy: Policy, config: PPOConfig, env: VecEnv, *, seed: int
) -> RecurrentPPO:
    """Build RecurrentPPO with KnowArm's network, epochs and minibatches.

    One LSTM serves actor and critic, and the heads are single layers, as in KnowArm.
    """
    steps = config.rollout_steps * config.num_envs
    return RecurrentPPO(
        "MultiInputLstmPolicy",
        env,
        learning_rate=config.learning_rate,
        n_steps=steps // env.num_envs,
        batch_size=steps // config.minibatches,
        n_epochs=config.epochs,
        gamma=config.gamma,
        gae_lambda=config.gae_lambda,
        clip_range=config.clip_range,
        ent_coef=config.ent_coef,
        vf_coef=config.vf_coef,
        max_grad_norm=config.max_grad_norm,
        policy_kwargs={
            "features_extractor_class": PaperFeatures,
            "features_extractor_kwargs": {"features": policy.fc.out_features},
            "lstm_hidden_size": policy.hidden_size,
            "shared_lstm": True,
            "enable_critic_lstm": False,
            "net_arch": [],
        },
        seed=seed,
        device="cpu",
    )


def single_environments(config: EnvConfig, table: np.ndarray, count: int) -> VecEnv:
    """Make ``count`` single environments in one process each, as Stable-Baselines3 does."""

    def make() -> ArmEnv:
        return ArmEnv(observe=SHOWN, knowledge=table, **vars(config))

    return SubprocVecEnv([make] * count, start_method="spawn")


class RolloutClock(BaseCallback):
    """Record steps and time at the start of every rollout, and end the training.

    Args:
        seconds: how long to train after the first rollout and update [s].
    """

    def __init__(self, seconds: float) -> None:
        super().__init__()
        self._seconds = seconds
        self.marks: list[tuple[int, float]] = []

    def _on_rollout_start(self) -> None:
        self.marks.append((self.num_timesteps, time.perf_counter()))

    def _on_step(self) -> bool:
        return (
            len(self.marks) < 3 or self.marks[-1][1] - self.marks[1][1] < self._seconds
        )


def parameter_count(model: Any) -> int:
    """Count the parameters of the policy of a Stable-Baselines3 model."""
    return sum(p.numel() for p in model.policy.parameters())


def main() -> None:
    config = tyro.cli(CompareLearnConfig, description=__doc__)
    check_output(config.json)
    result = compare_learn(config)
    print_learn(result)
    write_json_table(config.json, result)


if __name__ == "__main__":
    main()
