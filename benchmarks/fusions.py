"""Fusions on a supervised choice: find the object that a query means in an image of the task.

Images are starts of episodes of the choice task, with the arm in them. The policy's network, given
image and query, regresses where the wanted object stands, and is right if that is nearest to the
wanted one of the objects shown. No reinforcement learning is involved, so a fusion takes a minute.

    python -m benchmarks.fusions --fusions before_lstm film similarity
"""

import argparse
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import torch
from torch import Tensor, nn

from knowarm.experiment.build import build
from knowarm.experiment.graph_queries import GraphQueries
from knowarm.experiment.names import experiment_config
from knowarm.policy import Policy, PolicyConfig
from knowarm.world.envs.vector_env import ReachVectorEnv
from knowarm.world.tasks.choose.choose import Choose

BATCH, LEARNING_RATE, TEST_IMAGES = 256, 1.5e-3, 2048


@dataclass
class Starts:
    """Starts of N episodes that show m objects, the wanted one first."""

    image: Tensor
    """(N, H, W, 3) uint8."""
    query: Tensor
    """(N,) int64, rows of the knowledge table."""
    position: Tensor
    """(N, m, 2) float32, x and y of the objects, standardized over all of them."""


def draw_starts(env: ReachVectorEnv, count: int) -> Starts:
    """Draw at least ``count`` starts."""
    images: list[np.ndarray] = []
    queries: list[np.ndarray] = []
    positions: list[np.ndarray] = []
    observation, infos = env.reset(seed=0)
    while len(images) * env.num_envs < count:
        images.append(observation)
        queries.append(infos["query"])
        positions.append(infos["object_positions"])
        observation, infos = env.reset()
    position = np.concatenate(positions)
    position = (position - position.mean((0, 1))) / position.std((0, 1))
    return Starts(
        torch.from_numpy(np.concatenate(images)),
        torch.from_numpy(np.concatenate(queries)),
        torch.from_numpy(position).float(),
    )


class Finder(nn.Module):
    """A policy's network whose memory predicts where the wanted object stands."""

    def __init__(self, policy: Policy) -> None:
        super().__init__()
        self.policy = policy
        self.place = nn.Linear(policy.hidden_size, 2)

    def forward(self, image: Tensor, query: Tensor) -> Tensor:
        """Predict positions (N, 2) from images (N, H, W, 3) and queries (N,)."""
        policy, count = self.policy, len(image)
        start = torch.ones(count, dtype=torch.bool)
        _, _, (hidden, _) = policy.step(image, query, policy.initial_state(count), start)
        place: Tensor = self.place(hidden)
        return place


@torch.no_grad()
def accuracy(finder: Finder, starts: Starts, rows: Tensor) -> float:
    """Return the share of starts whose prediction is nearest to the wanted object."""
    predicted = torch.cat([finder(starts.image[r], starts.query[r]) for r in rows.split(BATCH)])
    squared = (starts.position[rows] - predicted[:, None]).square().sum(2)
    return (squared.argmin(1) == 0).float().mean().item()


def main() -> None:
    """Train a network per fusion on the same starts and print the share found in new ones."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fusions", nargs="+", default=["before_lstm", "film", "similarity"])
    parser.add_argument("--experiment", default="irb120-choose-query-onehot-fast")
    parser.add_argument("--images", type=int, default=20_000)
    parser.add_argument("--epochs", type=int, default=8)
    parser.add_argument("--size", type=int, default=64, help="height and width of images [px]")
    parser.add_argument("--pairs", default="colour", choices=["none", "colour", "all"])
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    config = experiment_config(arguments.experiment)
    task = cast(Choose, config.env.task)
    queries = replace(cast(GraphQueries, task.queries), pairs=arguments.pairs)
    task = replace(task, queries=queries)
    env_config = replace(config.env, image_size=arguments.size, task=task)
    parts = build(replace(config, env=env_config))
    env = ReachVectorEnv(env_config, 512, 1)
    starts = draw_starts(env, arguments.images + TEST_IMAGES)
    test = torch.arange(arguments.images, arguments.images + TEST_IMAGES)
    for fusion in arguments.fusions:
        policy_config = PolicyConfig(
            fusion=fusion, hidden="fixed", pixel_shift=0.5, pixel_scale=4.0
        )
        torch.manual_seed(arguments.seed)
        shape, table = parts.policy_shape, parts.table
        finder = Finder(Policy(policy_config, shape, table, seed=arguments.seed))
        optimizer = torch.optim.Adam(finder.parameters(), LEARNING_RATE)
        generator = torch.Generator().manual_seed(arguments.seed)
        shares = []
        for epoch in range(arguments.epochs):
            for group in optimizer.param_groups:
                group["lr"] = LEARNING_RATE * (1 - 0.9 * epoch / arguments.epochs)
            order = torch.randperm(arguments.images, generator=generator)
            for rows in order.split(BATCH):
                error = finder(starts.image[rows], starts.query[rows]) - starts.position[rows, 0]
                optimizer.zero_grad()
                error.square().mean().backward()
                optimizer.step()
            shares.append(f"{100 * accuracy(finder, starts, test):.0f}")
        print(f"{fusion}: right in new images after each epoch: {', '.join(shares)} %", flush=True)


if __name__ == "__main__":
    main()
