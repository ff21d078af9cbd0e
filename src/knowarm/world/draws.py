"""Stream, episode and draw numbers go in; uniform numbers come out, without generator objects.

Counter based: a draw is a hash of its three numbers, so any episode of any stream can be drawn at
once, in any order and at any batch size, and the state of a stream is two integers. The hash is
splitmix64's finalizer (Steele, Lea and Flood 2014) applied to each number in turn.
"""

import numpy as np
from numpy.typing import NDArray

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)


def uniforms(
    streams: NDArray[np.uint64], episodes: NDArray[np.uint64], count: int
) -> NDArray[np.float64]:
    """Draw the uniforms of episodes.

    Args:
        streams: seed of each episode's stream, (n,) uint64.
        episodes: index of the episode within its stream, (n,) uint64.
        count: numbers drawn for each episode.

    Returns:
        (n, count) float64 in [0, 1).
    """
    key = _mix(_mix(streams.astype(np.uint64)) ^ episodes.astype(np.uint64))
    draws = np.arange(count, dtype=np.uint64)
    bits = _mix(key[:, None] ^ _mix(draws)[None, :])
    return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53


def derive(seed: int, label: str) -> int:
    """Derive the seed of a stream that shares nothing with the streams seed, seed + 1, ...

    Args:
        seed: any integer.
        label: what the stream is for, as "evaluation".

    Returns:
        An integer in [0, 2**64).
    """
    digest = np.array([seed % 2**64], dtype=np.uint64)
    for byte in label.encode():
        digest = _mix(digest ^ np.uint64(byte))
    return int(digest[0])


def _mix(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Add the golden gamma and apply splitmix64's finalizer, modulo 2**64."""
    x = x + _GAMMA
    x = (x ^ (x >> np.uint64(30))) * _MIX_1
    x = (x ^ (x >> np.uint64(27))) * _MIX_2
    return x ^ (x >> np.uint64(31))
