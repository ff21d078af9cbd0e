"""A number of workers and their sizes go in; an error comes out if the machine cannot hold them."""

import psutil

from knowarm.errors import UserError
from knowarm.learn.config import A3CConfig

PROCESS_BYTES = 160 * 2**20
"""Private memory of one worker before its environments; measured (docs/learning.md)."""

IMAGE_COPIES = 12
"""Memory of a gradient step as a multiple of the rollout's images in bytes; measured (11)."""


def check_memory(config: A3CConfig, *, image_bytes: int, parameters: int) -> None:
    """Refuse more workers than the free memory holds.

    Args:
        config: number of workers and environments.
        image_bytes: size of one image.
        parameters: P; a worker holds values, gradient and temporaries of that size.

    Raises:
        UserError: naming the number of workers that would fit.
    """
    rollout = config.rollout_steps * config.envs_per_worker * image_bytes * IMAGE_COPIES
    each = PROCESS_BYTES + rollout + 5 * 4 * parameters
    available = psutil.virtual_memory().available
    fitting = max(0, int(available // each) - 1)
    if config.workers > fitting:
        raise UserError(
            f"{config.workers} workers and the evaluator need about "
            f"{(config.workers + 1) * each / 2**30:.1f} GiB of memory and "
            f"{available / 2**30:.1f} GiB are free: choose at most {fitting} workers (or fewer "
            "envs_per_worker)."
        )
