"""Fusions on a supervised choice: find the object that a query means in an image of the task.

Images are starts of episodes of the choice task, with the arm in them. The policy's network, given
image and query, regresses where the wanted object stands, and is right if that is nearest to the
wanted one of the objects shown. No reinforcement learning is involved, so a fusion takes a minute.

    python -m benchmarks.fusions --seeds 0 1 2 --out fusions.csv
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from knowarm.experiment.names import experiment_config
from knowarm.experiment.run import build
from knowarm.policy import Policy, PolicyConfig
from knowarm.policy.config import FUSIONS
from knowarm.world.envs.vector_env import ArmVectorEnv

BATCH, LEARNING_RATE, TEST_IMAGES = 256, 1.5e-3, 2048
FUSED = [name for name in FUSIONS if name not in ("none", "critic")]
"""Fusions by which knowledge reaches the memory or the actor."""


@dataclass
class Starts:
    """Starts of N episodes that show m objects, the wanted one first."""

    image: Tensor
    """(N, H, W, 3) uint8."""
    knowledge: Tensor
    """(N, K) float32, of the queries."""
    position: Tensor
    """(N, m, 2) float32, x and y of the objects, standardized over all of them."""


def draw_starts(env: ArmVectorEnv, table: np.ndarray, count: int, seed: int) -> Starts:
    """Draw at least ``count`` starts, with rows of the knowledge table."""
    images: list[np.ndarray] = []
    queries: list[np.ndarray] = []
    positions: list[np.ndarray] = []
    observation, infos = env.reset(seed=seed)
    while len(images) * env.num_envs < count:
        images.append(observation)
        queries.append(env.knowledge_input)
        positions.append(infos["object_positions"])
        observation, infos = env.reset()
    position = np.concatenate(positions)
    position = (position - position.mean((0, 1))) / position.std((0, 1))
    return Starts(
        torch.from_numpy(np.concatenate(images)),
        torch.from_numpy(table[np.concatenate(queries)]),
        torch.from_numpy(position).float(),
    )


def predicted(policy: Policy, starts: Starts, rows: Tensor) -> Tensor:
    """Predict where the wanted objects of ``rows`` stand, (N, 2), by the head of the actor."""
    start = torch.ones(len(rows), dtype=torch.bool)
    state = policy.initial_state(len(rows))
    return policy.step(starts.image[rows], starts.knowledge[rows], state, start)[
        0
    ].squeeze(2)


@torch.no_grad()
def accuracy(policy: Policy, starts: Starts, rows: Tensor) -> float:
    """Return the share of starts whose prediction is nearest to the wanted object."""
    places = torch.cat([predicted(policy, starts, each) for each in rows.split(BATCH)])
    squared = (starts.position[rows] - places[:, None]).square().sum(2)
    return (squared.argmin(1) == 0).float().mean().item()


def train(
    policy: Policy, starts: Starts, images: int, epochs: int, generator: torch.Generator
) -> float:
    """Train on the first ``images`` starts and return the share of right objects in the others."""
    optimizer = torch.optim.Adam(policy.parameters(), LEARNING_RATE)
    for epoch in range(epochs):
        for group in optimizer.param_groups:
            group["lr"] = LEARNING_RATE * (1 - 0.9 * epoch / epochs)
        for rows in torch.randperm(images, generator=generator).split(BATCH):
            error = predicted(policy, starts, rows) - starts.position[rows, 0]
            optimizer.zero_grad()
            error.square().mean().backward()
            optimizer.step()
    return accuracy(policy, starts, torch.arange(images, images + TEST_IMAGES))


def main() -> None:
    """Train a network per seed and fusion and print the share found in new images."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fusions", nargs="+", default=FUSED, choices=FUSED)
    parser.add_argument(
        "--experiment", default="irb120-choose-subgraph-before-lstm-fast"
    )
    parser.add_argument("--images", type=int, default=20_000)
    parser.add_argument("--epochs", type=int, default=8)
    parser.add_argument(
        "--size", type=int, default=64, help="height and width of images [px]"
    )
    parser.add_argument("--pairs", default="colour", choices=["none", "colour", "all"])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--out", type=Path, help="CSV of all shares")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    config = experiment_config(arguments.experiment)
    task = config.env.task.asking(pairs=arguments.pairs)
    env_config = replace(config.env, image_size=arguments.size, task=task)
    found = []
    for seed in arguments.seeds:
        parts = build(replace(config, env=env_config, seed=seed))
        # X and y instead of actions
        shape = replace(parts.policy_shape, joints=2, levels=1)
        env = ArmVectorEnv(env_config, 512, 1)
        starts = draw_starts(
            env, parts.knowledge.table, arguments.images + TEST_IMAGES, seed
        )
        for fusion in arguments.fusions:
            policy_config = PolicyConfig(
                fusion=fusion, hidden="fixed", pixel_shift=0.5, pixel_scale=4.0
            )
            policy = Policy(policy_config, shape, seed=seed)
            generator = torch.Generator().manual_seed(seed)
            share = train(policy, starts, arguments.images, arguments.epochs, generator)
            print(
                f"{fusion}, seed {seed}: right in new images {100 * share:.1f} %",
                flush=True,
            )
            budget = f"{arguments.images},{arguments.epochs}"
            found.append(f"{budget},{fusion},{seed},{100 * share:.1f}")
            if arguments.out is not None:
                text = "\n".join(["images,epochs,fusion,seed,right_percent", *found])
                arguments.out.write_text(text + "\n")


if __name__ == "__main__":
    main()
