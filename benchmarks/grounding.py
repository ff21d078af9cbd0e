"""Grounding without an arm: the object that a query means, found in the first images of splits.

Trains the grounding network of each agent, as `knowarm train` does before the first step, and
prints how often the grasp point that it predicts is nearest to the wanted object's, and how far,
then, the predicted grasp frame is from the true one (medians, position and z axis). No
reinforcement learning is involved, so what an agent's knowledge is worth on splits S1 to S5 is
known in minutes.

    python -m benchmarks.grounding --agents subgraph query-words query-onehot subgraph-shuffled
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import cast

import torch

from knowarm.experiment.knows import Grounded
from knowarm.experiment.names import experiment_config
from knowarm.perception.grounding_training import train_grounding
from knowarm.perception.images import LabelledImages, sample_images
from knowarm.perception.recognition import FrameRecognition
from knowarm.seeding import derive_seed
from knowarm.world.config import EnvConfig, facets_of

AGENTS = ["subgraph", "query-words", "query-onehot", "subgraph-shuffled"]
SETTINGS = {
    "images": "training images per round",
    "rounds": "rounds",
    "shared_rounds": "rounds of names and grasp frames alone, before the queries",
    "batch": "images per gradient step",
}
"""Fields of the grounding config that may be given; else they are the agent's."""


def with_split(env: EnvConfig, split: str) -> EnvConfig:
    """Return the task that asks the questions of a split."""
    return replace(env, task=env.task.asking(split=split))


@torch.no_grad()
def measure(known: FrameRecognition, labels: LabelledImages) -> str:
    """Describe the share of right objects, and the errors of their grasp frames."""
    network, frame = known.network, known(labels.images, labels.queries)
    position = frame[:, :3] * network.position_std + network.position_mean
    distance = (labels.grasp_position - position[:, None]).norm(dim=2)
    right = distance.argmin(1) == 0
    away = 100 * distance[right, 0].median()
    cosine = torch.cosine_similarity(frame[right, 6:], labels.grasp_axes[right, 0, 3:])
    angle = cosine.clamp(-1, 1).acos().rad2deg().median()
    return f"{100 * right.float().mean():.1f} % ({away:.1f} cm, {angle:.1f} degrees)"


def main() -> None:
    """Train a network per agent and seed and print the share of right objects per split."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agents", nargs="+", default=AGENTS)
    parser.add_argument("--robot", default="irb120")
    for name, about in SETTINGS.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=int, help=about)
    parser.add_argument("--test-images", type=int, default=1_000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--out", type=Path, help="file for the last network")
    arguments = parser.parse_args()
    given = {name: value for name, value in vars(arguments).items() if name in SETTINGS}
    given = {name: value for name, value in given.items() if value is not None}
    for seed in arguments.seeds:
        for agent in arguments.agents:
            name = f"{arguments.robot}-choose-{agent}-fast"
            config = experiment_config(name, seed=seed, knows={"grounding": given})
            knows, begin = cast(Grounded, config.knows), time.process_time()
            knowledge = knows.known(config.env, seed)
            assert knowledge.embedding is not None
            slots = knowledge.embedding.slots_per_row
            network = train_grounding(
                config.env, knowledge.table, slots, knows.grounding, seed=seed
            )
            assert network is not None
            if arguments.out is not None:
                network.write(arguments.out)
            seconds, shares = time.process_time() - begin, []
            for number, split in enumerate(("S1", "S2", "S3", "S4", "S5"), 1):
                env = with_split(config.env, split)
                labels = sample_images(
                    env,
                    network.spec,
                    arguments.test_images,
                    derive_seed(0, "perception", number),
                )
                graph = env.task.asked.edited_graph(facets_of(env))
                described = knows.known(env, seed, graph=graph, trained=config.env)
                known = FrameRecognition(network, described.table)
                shares.append(f"{split} {measure(known, labels)}")
            print(
                f"{agent}, seed {seed}: {', '.join(shares)}, {seconds:.0f} s",
                flush=True,
            )


if __name__ == "__main__":
    main()
