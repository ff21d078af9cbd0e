"""Seeding: an independent stream of random numbers for each run seed, purpose and index.

Every stream starts from a hash of (seed, purpose, indices), so neighbouring seeds, purposes and
workers share no numbers. `torch.Generator.manual_seed` alone does not give that: on the CPU it
keeps the lowest 32 bits of a seed, hence seeds that differ by a multiple of 2**32 are equal there.
"""

from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from knowarm.errors import UserError

if TYPE_CHECKING:
    import torch

Purpose = Literal[
    "weights",  # initial weights of the policy
    "episodes",  # the environments' streams; A3C: worker, number of its restarts, or the step
    "actions",  # sampled actions of training; A3C: worker, number of its restarts
    "minibatches",  # order of the environments in PPO's passes
    "placebos",  # random vectors and shuffled graphs; the knowledge's seed, 0
    "interim_actions",  # draws nothing: interim evaluations are greedy
    "splits",  # what the splits of a choose task hold out; number of the split
    "perception",  # weights and images of a grounding network; number of the images and of the test
    "damage",  # which triples of a graph an evaluation damages; number of the kind
]
"""What random numbers are drawn for, with the meaning of the indices. The position of a purpose is
part of its stream: append new purposes at the end.
"""

_PURPOSES: tuple[Purpose, ...] = get_args(Purpose)


def seed_sequence(seed: int, purpose: Purpose, *indices: int) -> np.random.SeedSequence:
    """Return the seed sequence of a run's stream; indices tell those of one purpose apart.

    Raises:
        UserError: the seed is negative.
    """
    if seed < 0:
        raise UserError(f"seed must be at least 0, got {seed}.")
    return np.random.SeedSequence(seed, spawn_key=(_PURPOSES.index(purpose), *indices))


def derive_seed(seed: int, purpose: Purpose, *indices: int) -> int:
    """Derive an integer in [0, 2**63) from a stream, for libraries that take an integer.

    Its lowest 32 bits are independent of those of other streams, too.
    """
    (word,) = seed_sequence(seed, purpose, *indices).generate_state(1, np.uint64)
    return int(word) % 2**63


def torch_generator(
    seed: int, purpose: Purpose, *indices: int, device: "torch.device | str" = "cpu"
) -> "torch.Generator":
    """Create a PyTorch generator at the start of a stream; its seed is the same on every device."""
    import torch  # takes a second to import

    return torch.Generator(device).manual_seed(derive_seed(seed, purpose, *indices))
