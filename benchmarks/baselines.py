"""Baselines of the benchmark that other libraries train: a file per training seed.

Recurrent PPO of sb3-contrib and SAC of Stable-Baselines3 learn from pixels and reward, behaviour
cloning learns from the oracle's episodes. The budgets are small, half a minute on one core and 15
minutes for recurrent PPO, and counted in steps, so that the same seed gives the same policy.

    python -m benchmarks.baselines cloning --cell tiago-fixed --seeds 0 1 2 3 4 --out baselines
    knowarm benchmark run reach-v1 --cells tiago-fixed --policy baselines/cloning-tiago-fixed-?.onnx
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import onnx
import torch
from gymnasium import spaces
from gymnasium.vector import VectorWrapper
from gymnasium.wrappers.vector import TransformReward
from numpy.typing import NDArray
from sb3_contrib import RecurrentPPO
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from knowarm.benchmark.suites import Cell, read_suite
from knowarm.learn.algorithms import PPOConfig
from knowarm.learn.sb3_vec_env import SB3VecEnv
from knowarm.world.agents import Batch, OracleAgent
from knowarm.world.agents.play import play_steps
from knowarm.world.agents.protocol import Observations
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import draw_episodes
from knowarm.world.envs.running import joint_increments
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.state import ACTION_LEVELS

LEVELS = np.array(ACTION_LEVELS, np.float32)
SAC_REWARD_SCALE = 0.1
PPO_REWARD_SCALE = PPOConfig().reward_scale
RECURRENT_PPO_STEPS = 2_000_000
DEMONSTRATIONS = 1_000
"""Episodes of the oracle that behaviour cloning fits."""


def convolutions() -> nn.Sequential:
    """Return a small network from images (B, 3, 64, 64) to features (B, 512)."""
    return nn.Sequential(
        *(nn.Conv2d(3, 16, 8, 4), nn.ReLU()),
        *(nn.Conv2d(16, 32, 4, 2), nn.ReLU()),
        *(nn.Conv2d(32, 32, 3), nn.ReLU(), nn.Flatten()),
    )


class Pixels(BaseFeaturesExtractor):
    """Features of images (B, 3, 64, 64) for recurrent PPO."""

    def __init__(self, space: spaces.Space[Any]) -> None:
        super().__init__(space, 512)
        self.image = convolutions()

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Compute the features, (B, 512)."""
        return cast(torch.Tensor, self.image(observations))


class Coarse(BaseFeaturesExtractor):
    """Features of images at a quarter of their size and of joint targets, for SAC."""

    def __init__(self, space: spaces.Dict) -> None:
        super().__init__(space, 800 + space["joint_targets"].shape[0])  # type: ignore[index]
        self.image = nn.Sequential(
            *(nn.AvgPool2d(4), nn.Conv2d(3, 32, 3, 2), nn.ReLU()),
            *(nn.Conv2d(32, 32, 3), nn.ReLU(), nn.Flatten()),
        )

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Compute the features, (B, 800 + J)."""
        return torch.cat(
            [self.image(observations["image"]), observations["joint_targets"]], 1
        )


class Continuous(VectorWrapper):
    """Adds the joint targets to the image, and plays actions (n, J) in [-1, 1] as nearest levels.

    An action is a joint increment in units of the MPI.
    """

    def __init__(self, env: ArmVectorEnv) -> None:
        super().__init__(env)
        self._arm = env
        n, joints = env.num_envs, env.scene.num_joints
        self._increments = joint_increments(env.scene.robot, env.config)
        targets = [
            spaces.Box(-np.inf, np.inf, (*each, joints), np.float32)
            for each in ((), (n,))
        ]
        self.single_observation_space, self.observation_space = (
            spaces.Dict({"image": image, "joint_targets": space})
            for image, space in zip(
                (env.single_observation_space, env.observation_space),
                targets,
                strict=True,
            )
        )
        self.single_action_space = spaces.Box(-1, 1, (joints,), np.float32)
        self.action_space = spaces.Box(-1, 1, (n, joints), np.float32)

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Start episodes."""
        images, infos = self.env.reset(**options)
        return self._observe(images, self._arm.joint_targets), infos

    def step(self, actions: Any) -> Any:
        """Play one step."""
        levels = np.abs(np.asarray(actions)[..., None] - LEVELS).argmin(-1)
        scene = self._arm.scene
        reached = self._arm.joint_targets + self._increments[levels]
        reached = reached.clip(scene.joint_lower, scene.joint_upper)
        images, rewards, terminated, truncated, infos = self.env.step(levels)
        if "final_obs" in infos:
            final = infos["final_obs"].copy()
            for i in np.flatnonzero(infos["_final_obs"]):
                final[i] = {
                    "image": final[i],
                    "joint_targets": reached[i].astype(np.float32),
                }
            infos = infos | {"final_obs": final}
        seen = self._observe(images, self._arm.joint_targets)
        return seen, SAC_REWARD_SCALE * rewards, terminated, truncated, infos

    @staticmethod
    def _observe(
        images: NDArray[np.uint8], targets: NDArray[np.float64]
    ) -> dict[str, Any]:
        return {"image": images, "joint_targets": targets.astype(np.float32)}


class Progress(BaseCallback):
    """Prints steps, processor time and success of the last 500 training episodes."""

    def __init__(self) -> None:
        super().__init__()
        self._begin, self._next = time.process_time(), 0.0
        self._ends: list[bool] = []

    def _on_step(self) -> bool:
        self._ends += [
            info["is_success"] for info in self.locals["infos"] if "is_success" in info
        ]
        spent = time.process_time() - self._begin
        if spent > self._next and self._ends:
            share = np.mean(self._ends[-500:])
            print(
                f"{self.num_timesteps:8,} steps, {spent:4.0f} s: {share:.3f}",
                flush=True,
            )
            self._next = spent + 10
        return True


def recurrent_ppo(cell: Cell, seed: int, out: Path) -> None:
    """Train sb3-contrib's recurrent PPO on images, with the settings of KnowArm's `PPOConfig`."""
    arm = ArmVectorEnv(cell.env, 128, num_threads=1)
    env = SB3VecEnv(
        TransformReward(arm, lambda rewards: PPO_REWARD_SCALE * rewards), seed=seed
    )
    model = RecurrentPPO(
        "CnnLstmPolicy",
        env,
        n_steps=25,
        batch_size=800,
        n_epochs=2,
        learning_rate=lambda left: 1e-3 * max(left, 0.1),
        gamma=0.95,
        gae_lambda=0.95,
        ent_coef=0.003,
        policy_kwargs={
            "features_extractor_class": Pixels,
            "lstm_hidden_size": 128,
            "shared_lstm": True,
            "enable_critic_lstm": False,
            "net_arch": [],
        },
        seed=seed,
    )
    model.learn(RECURRENT_PPO_STEPS, Progress())
    model.save(out / f"recurrent-ppo-{cell.name}-{seed}")


def sac(cell: Cell, seed: int, out: Path) -> None:
    """Train Stable-Baselines3's SAC on images and joint targets, with continuous actions."""
    env = SB3VecEnv(Continuous(ArmVectorEnv(cell.env, 16, num_threads=1)), seed=seed)
    model = SAC(
        "MultiInputPolicy",
        env,
        buffer_size=3_200,
        learning_starts=800,
        batch_size=64,
        gradient_steps=4,
        gamma=0.95,
        learning_rate=5e-4,
        policy_kwargs={
            "features_extractor_class": Coarse,
            "net_arch": [256, 256],
            "share_features_extractor": True,
        },
        seed=seed,
    )
    model.learn(3_200, Progress())
    model.save(out / f"sac-{cell.name}-{seed}")


class Cloned(nn.Module):
    """Policy without memory: image (B, 64, 64, 3) uint8 and joint targets (B, J) to levels."""

    def __init__(self, joints: int) -> None:
        super().__init__()
        self.image = convolutions()
        self.head = nn.Sequential(
            nn.Linear(512 + joints, 256),
            nn.ReLU(),
            nn.Linear(256, joints * len(LEVELS)),
        )

    def forward(self, image: torch.Tensor, joint_targets: torch.Tensor) -> torch.Tensor:
        """Compute the logits, (B, J, 7)."""
        features = self.image(image.permute(0, 3, 1, 2).float() / 255)
        logits = self.head(torch.cat([features, joint_targets], 1))
        return cast(torch.Tensor, logits.unflatten(1, (-1, len(LEVELS))))


class Disturbed:
    """Plays the oracle with a share of random actions; ``labels`` are what it would have done."""

    def __init__(self, env: ArmVectorEnv, seed: int, share: float = 0.1) -> None:
        self._oracle, self._share = OracleAgent(env), share
        self._rng = np.random.default_rng(seed)

    def reset(self, batch: Batch) -> None:
        """Solve the episodes."""
        self._oracle.reset(batch)

    def act(self, observations: Observations) -> NDArray[np.int64]:
        """Return actions (n, J)."""
        self.labels = self._oracle.act(observations)
        random = self._rng.integers(len(LEVELS), size=self.labels.shape)
        return np.where(
            self._rng.random((len(random), 1)) < self._share, random, self.labels
        )


def demonstrations(
    config: EnvConfig, count: int, seed: int
) -> tuple[torch.Tensor, ...]:
    """Play training episodes; return images, joint targets and the oracle's actions."""
    env = ArmVectorEnv(config, 100, num_threads=1)
    agent = Disturbed(env, seed)
    rows: list[tuple[NDArray[Any], ...]] = []
    for first in range(0, count, 100):
        numbers = np.arange(first, first + 100, dtype=np.uint64)
        streams = np.full(100, seed, np.uint64)
        seen = None
        for moment in play_steps(agent, env, draw_episodes(config, streams, numbers)):
            if seen is not None:
                rows.append(
                    tuple(each[moment.played] for each in (*seen, agent.labels))
                )
            seen = moment.images.copy(), env.joint_targets
    images, targets, labels = map(np.concatenate, zip(*rows, strict=True))
    return tuple(map(torch.from_numpy, (images, targets.astype(np.float32), labels)))


def cloning(cell: Cell, seed: int, out: Path) -> None:
    """Fit a network to the oracle's actions in eight epochs; write it as ONNX."""
    from knowarm.deploy.onnx_export import export_onnx

    images, targets, labels = demonstrations(cell.env, DEMONSTRATIONS, seed)
    torch.manual_seed(seed)
    model, batches = Cloned(targets.shape[1]), 8 * [*range(0, len(images), 256)]
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, len(batches))
    for first in batches:
        if first == 0:
            order = torch.randperm(len(images))
        rows = order[first : first + 256]
        logits = model(images[rows], targets[rows])
        loss = nn.functional.cross_entropy(logits.flatten(0, 1), labels[rows].flatten())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if first == 0:
            print(f"{len(images):,} images, loss {loss.item():.3f}", flush=True)
    path = out / f"cloning-{cell.name}-{seed}.onnx"
    example = images[:2], targets[:2]
    export_onnx(
        model, example, path, inputs=("image", "joint_targets"), outputs=("logits",)
    )
    declare(path)


def declare(path: Path) -> None:
    """Store in an ONNX file how it was trained."""
    model = onnx.load(path)
    training = (
        f"{DEMONSTRATIONS:,} episodes of the oracle, which reads the simulator's state"
    )
    onnx.helper.set_model_props(model, {"training": training})
    onnx.save(model, path)


METHODS: dict[str, Callable[[Cell, int, Path], None]] = {
    "recurrent-ppo": recurrent_ppo,
    "sac": sac,
    "cloning": cloning,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("method", choices=METHODS)
    parser.add_argument("--cell", default="tiago-fixed")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--out", type=Path, default=Path("baselines"))
    given = parser.parse_args()
    torch.set_num_threads(1)
    given.out.mkdir(parents=True, exist_ok=True)
    cell = read_suite("reach-v1").cells[given.cell]
    for seed in given.seeds:
        begin = time.process_time()
        METHODS[given.method](cell, seed, given.out)
        print(
            f"{given.method} seed {seed}: {time.process_time() - begin:.0f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
