"""Frame head of a grounding network, trained anew on the features that the network has.

Reads the grounding network of a run, trains a head that predicts grasp frames from the 3 x 3 places
around an object, as `knowarm train` does after a network, and writes the network with it; names,
keys and queries stay as they are. Prints for both networks how far the frames at the true places
are from the true ones in new images.

    python -m benchmarks.frame_head zoo/irb120-choose-answers-fast --out irb120.safetensors
    knowarm train irb120-choose-answers-distil --perception irb120.safetensors
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import cast

import torch

from knowarm.cores import torch_threads
from knowarm.experiment.knows import Grounded
from knowarm.experiment.load import load_agent
from knowarm.perception.config import GroundingConfig
from knowarm.perception.grounding import BATCH, GroundingNetwork, place_of
from knowarm.perception.grounding_training import train_frame_head
from knowarm.perception.images import LabelledImages, sample_images
from knowarm.seeding import derive_seed

STREAM = 10
"""Number of the random stream of the test's images."""


@torch.no_grad()
def errors(network: GroundingNetwork, labels: LabelledImages) -> str:
    """Describe the errors of the frames at the true places."""
    places = place_of(labels.pixels, network.spec.image_size)
    parts = zip(labels.images.split(BATCH), places.split(BATCH), strict=True)
    frames = torch.cat(
        [network.frames(network.encoder.features(i), p) for i, p in parts]
    )
    position = frames[..., :3] * network.position_std + network.position_mean
    distance = 100 * (position - labels.grasp_position).norm(dim=-1).flatten()
    axes = zip(
        frames[..., 3:].split(3, -1), labels.grasp_axes.split(3, -1), strict=True
    )
    cosines = [torch.cosine_similarity(*pair, dim=-1).flatten() for pair in axes]
    angle = torch.stack(cosines).amin(0).clamp(-1, 1).acos().rad2deg()
    within = ((distance < 5) & (angle < 15)).float().mean()
    return (
        f"median {distance.median():.1f} cm and {angle.median():.1f} degrees, 97 % below "
        f"{distance.quantile(0.97):.1f} cm and {angle.quantile(0.97):.1f} degrees; within 5 cm and "
        f"15 degrees {100 * within:.1f} %"
    )


def main() -> None:
    """Train the head, print both networks' errors, and write the new network."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--images", type=int, default=GroundingConfig.images)
    parser.add_argument("--test-images", type=int, default=1_000)
    arguments = parser.parse_args()
    trained = load_agent(arguments.run)
    if trained.network is None:
        raise SystemExit("Give a run with a grounding network.")
    seed, env = trained.config.seed, trained.config.env
    config = replace(
        cast(Grounded, trained.config.knows).grounding, images=arguments.images
    )
    made = train_frame_head(trained.network, env, config, seed=seed, report=print)
    assert made is not None
    with torch_threads(1):
        test = derive_seed(seed, "perception", STREAM)
        labels = sample_images(env, made.spec, arguments.test_images, test)
        for name, network in (("before", trained.network), ("after", made)):
            print(f"{name}: {errors(network, labels)}")
    made.write(arguments.out)


if __name__ == "__main__":
    main()
