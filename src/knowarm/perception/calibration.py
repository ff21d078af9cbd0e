"""Calibration: which visible objects may be the answer, at a level of confidence.

Split conformal prediction (Vovk et al. 2005): on held-out images, the likelihood that the network
gives to the right name of a visible object has a quantile; every visible object that answers with
at least this likelihood is a candidate. Each object has a quantile of its own (Mondrian, or
label-conditional, conformal prediction: Vovk 2012), so that an object that is hard to recognize is
among the candidates as often as the level says, too, on scenes like those of training.
"""

import math
from importlib.metadata import version

import numpy as np
import torch
from torch import Tensor

from knowarm.errors import UserError
from knowarm.perception.grounding import GroundingNetwork, centres, in_batches
from knowarm.perception.images import pixels_of, sample_images
from knowarm.perception.recognition import AnswerGrounding
from knowarm.questions import number_objects
from knowarm.seeding import derive_seed
from knowarm.world.cache import cache_file, read_arrays, write_arrays
from knowarm.world.config import EnvConfig
from knowarm.world.scene.scene import Scene

IMAGES = 1_000
"""Held-out images."""
STREAM = 3
"""Number of their random stream."""
FEWEST = 3
"""Fewest scores of an object up to its quantile; with fewer, the quantile of all objects counts."""


def calibrated_thresholds(
    network: GroundingNetwork, env: EnvConfig, level: float, seed: int
) -> Tensor:
    """Return the likelihood from which a visible object is a candidate, by facet, (F,) float32.

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
    file = cache_file("calibration-by-object", *depends_on)
    arrays = read_arrays(file)
    if arrays is None:
        arrays = name_likelihoods(network, env, seed)
        write_arrays(file, arrays)
    objects = number_objects(network.spec.facets)
    return torch.from_numpy(
        thresholds_of(arrays["likelihoods"], arrays["facets"], objects, level)
    )


def thresholds_of(
    likelihoods: np.ndarray, facets: np.ndarray, objects: np.ndarray, level: float
) -> np.ndarray:
    """Return the quantile of each facet's object, (F,) float32, of likelihoods of facets (n,).

    ``objects`` (F,) are the numbers of the facets' objects.
    """
    thresholds = np.full(len(objects), quantile(likelihoods, level), np.float32)
    seen = objects[facets]
    for number in np.unique(seen):
        scores = likelihoods[seen == number]
        if rank(len(scores), level) >= FEWEST:
            thresholds[objects == number] = quantile(scores, level)
    return thresholds


@torch.inference_mode()
def name_likelihoods(
    network: GroundingNetwork, env: EnvConfig, seed: int
) -> dict[str, np.ndarray]:
    """Return the likelihoods of the right names in held-out images, and the facets, (n,) each.

    All m visible objects of `IMAGES` images count, n = m * IMAGES.
    """
    spec = network.spec
    labels = sample_images(env, spec, IMAGES, derive_seed(seed, "perception", STREAM))
    anything = torch.ones(1, len(spec.facets))
    grounding = AnswerGrounding(network, anything)

    def of_names(images: Tensor, facets: Tensor, pixels: Tensor) -> Tensor:
        seen = grounding.see(images, anything.expand(len(images), -1))
        rows = torch.arange(len(images))
        likelihoods = []
        for facet, pixel in zip(facets.T, pixels.unbind(1), strict=True):
            nearest = nearest_place(seen.places, pixel, spec.image_size)
            likelihoods.append(seen.likelihoods[rows, facet, nearest])
        return torch.stack(likelihoods, dim=1)

    likelihoods = in_batches(of_names, labels.images, labels.facets, labels.pixels)
    return {
        "likelihoods": likelihoods.flatten().numpy(),
        "facets": labels.facets.flatten().numpy(),
    }


def rank(count: int, level: float) -> int:
    """Return how many of some scores lie up to their quantile, itself among them."""
    return math.floor((count + 1) * (1 - level) + 1e-9)  # 1 - .8 is below .2


def quantile(scores: np.ndarray, level: float) -> float:
    """Return the score (n,) that a further one reaches with at least the probability ``level``."""
    number = rank(len(scores), level)
    if number == 0:
        return 0.0
    return float(np.sort(scores)[number - 1])


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
