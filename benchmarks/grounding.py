"""Grounding without an arm: the object that a query means, found in the first images of splits.

Trains the grounding network of each agent, as `knowarm train` does before the first step, and
prints how often the place that it finds is nearest to the wanted object. No reinforcement learning
is involved, so what an agent's knowledge is worth on splits S1 to S5 is known in minutes.

    python benchmarks/grounding.py --agents subgraph query-words query-onehot subgraph-shuffled
"""

import argparse
import time
from dataclasses import replace

import torch

from knowarm.experiment.build import build, slots_of
from knowarm.experiment.graph_queries import retold
from knowarm.experiment.grounding import Grounding, centres
from knowarm.experiment.grounding_training import Starts, draw_starts, train_grounding
from knowarm.experiment.registry import experiment_config
from knowarm.knowledge.query_splits import SPLITS
from knowarm.seeding import derive_seed
from knowarm.world.config import EnvConfig

AGENTS = ["subgraph", "query-words", "query-onehot", "subgraph-shuffled"]


def with_split(env: EnvConfig, split: str) -> EnvConfig:
    """Return the task that asks the questions of a split."""
    assert env.choice is not None
    queries = replace(env.choice.queries, split=split)
    return replace(env, choice=replace(env.choice, queries=queries))


def share_right(network: Grounding, starts: Starts) -> float:
    """Return the share of starts whose place is nearest to the wanted object."""
    parts = zip(starts.images.split(256), starts.queries.split(256), strict=True)
    with torch.no_grad():
        places = torch.cat([network.places(*part) for part in parts])
    point = centres(starts.images.shape[1])[places]
    nearest = (starts.pixels - point[:, None]).square().sum(2).argmin(1)
    return float((nearest == 0).float().mean())


def main() -> None:
    """Train a network per agent and seed and print the share of right objects per split."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agents", nargs="+", default=AGENTS)
    parser.add_argument("--robot", default="irb120")
    parser.add_argument("--images", type=int, help="training images; default: the agent's")
    parser.add_argument("--epochs", type=int, help="passes over them; default: the agent's")
    parser.add_argument("--test-images", type=int, default=1_000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    arguments = parser.parse_args()
    given = {name: getattr(arguments, name) for name in ("images", "epochs")}
    given = {name: value for name, value in given.items() if value is not None}
    for seed in arguments.seeds:
        for agent in arguments.agents:
            name = f"{arguments.robot}-choose-{agent}-fast"
            config = experiment_config(name, seed=seed, grounding=given)
            assert config.grounding is not None
            parts, begin = build(config), time.process_time()
            network = train_grounding(
                config.env, parts.table, slots_of(parts.embedding), config.grounding, seed=seed
            )
            assert network is not None
            seconds, shares = time.process_time() - begin, []
            for number, split in enumerate(SPLITS, 1):
                env = with_split(config.env, split)
                starts = draw_starts(
                    env, network.seen, arguments.test_images, derive_seed(0, "perception", number)
                )
                if split == "S5":
                    network.knowledge = torch.from_numpy(retold(config, env))
                shares.append(f"{split} {100 * share_right(network, starts):.1f}")
            print(f"{agent}, seed {seed}: {', '.join(shares)} %, {seconds:.0f} s", flush=True)


if __name__ == "__main__":
    main()
