"""Calibration: which visible objects may be the answer, at a level of confidence.

Split conformal prediction (Vovk et al. 2005): on held-out images, the likelihood that the network
gives to the name of the right object has a quantile; every visible object that answers with at
least this likelihood is a candidate. The right one is among them as often as the level says, for
any question, on scenes like those of training.
"""

import math
from importlib.metadata import version

import numpy as np
import torch
from torch import Tensor

from knowarm.errors import UserError
from knowarm.perception.answering import AnswerGrounding
from knowarm.perception.grounding import GroundingNetwork, centres, in_batches
from knowarm.perception.images import pixels_of, sample_images
from knowarm.seeding import derive_seed
from knowarm.world.cache import cache_file, read_arrays, write_arrays
from knowarm.world.config import EnvConfig
from knowarm.world.scene.scene import Scene

IMAGES = 1_000
"""Held-out images."""
STREAM = 3
"""Number of their random stream."""


def calibrated_threshold(
    network: GroundingNetwork, env: EnvConfig, level: float, seed: int
) -> float:
    """Return the likelihood from which a visible object is a candidate.

    What it is computed from is kept in the user's cache.

    Args:
        network: the grounding network.
        env: the task of its training.
        level: how often the right object shall be among the candidates, above 0 and below 1.
        seed: of the network's training, which never drew the same images.
    """
    if not 0 < level < 1:
        raise UserError(
            f"level is {level}; it must be above 0 and below 1, such as 0.9."
        )
    depends_on = (IMAGES, version("torch"), env, seed, network.to_bytes())
    file = cache_file("calibration", *depends_on)
    arrays = read_arrays(file)
    if arrays is None:
        arrays = {"likelihood": target_likelihoods(network, env, seed)}
        write_arrays(file, arrays)
    return quantile(arrays["likelihood"], level)


@torch.inference_mode()
def target_likelihoods(
    network: GroundingNetwork, env: EnvConfig, seed: int
) -> np.ndarray:
    """Return the likelihood of the name of the right object in held-out images, (IMAGES,)."""
    spec = network.spec
    labels = sample_images(env, spec, IMAGES, derive_seed(seed, "perception", STREAM))
    answers = torch.nn.functional.one_hot(labels.facets[:, 0], len(spec.facets))
    grounding = AnswerGrounding(network, answers)

    def of_targets(images: Tensor, answers: Tensor, pixels: Tensor) -> Tensor:
        seen = grounding.see(images, answers)
        nearest = nearest_place(seen.places, pixels, spec.image_size)
        return seen.likelihood.gather(1, nearest[:, None])[:, 0]

    return in_batches(of_targets, labels.images, answers, labels.pixels[:, 0]).numpy()


def quantile(scores: np.ndarray, level: float) -> float:
    """Return the score (n,) that a further one reaches with at least the probability ``level``."""
    rank = math.floor((len(scores) + 1) * (1 - level) + 1e-9)  # 1 - .8 is below .2
    if rank == 0:
        return 0.0
    return float(np.sort(scores)[rank - 1])


def nearest_place(places: Tensor, pixels: Tensor, image_size: int) -> Tensor:
    """Return which of m places (n, m) is nearest to a point of the image (n, 2) [px], (n,)."""
    way = centres(image_size)[places] - pixels[:, None]
    return way.square().sum(2).argmin(1)


def covered(
    places: np.ndarray,
    candidates: np.ndarray,
    scene: Scene,
    positions: np.ndarray,
    image_size: int,
) -> np.ndarray:
    """Return whether the object at ``positions`` (n, 2) [m] is a candidate, (n,) bool.

    Args:
        places: of the named objects, (n, m).
        candidates: which of them are candidates, (n, m) bool.
        scene: the scene.
        positions: x and y of the right object.
        image_size: width of the images [px].
    """
    pixels = pixels_of(scene, positions, image_size)
    nearest = nearest_place(torch.from_numpy(places), pixels, image_size)
    return np.asarray(candidates[np.arange(len(nearest)), nearest.numpy()])
