"""Counter-based random numbers: uniform draws by stream, episode and draw number.

A draw is a hash of its three numbers, so any episodes of any streams can be drawn in one batch, in
any order, and the state of a stream is two integers. The hash is
splitmix64's finalizer (Steele, Lea and Flood 2014) applied to each number in turn.
"""

import numpy as np
from numpy.typing import NDArray

Words = NDArray[np.uint64]

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)


def uniforms(streams: Words, episodes: Words, count: int) -> NDArray[np.float64]:
    """Draw ``count`` uniforms in [0, 1) for each stream's seed and episode's number, (n, count)."""
    key = _mix(_mix(streams) ^ episodes)
    draws = np.arange(count, dtype=np.uint64)
    bits = _mix(key[:, None] ^ _mix(draws)[None, :])
    return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53


def derive(seed: int, label: str) -> int:
    """Derive a 64-bit seed that is unrelated to the streams seed, seed + 1, ... for a purpose."""
    digest = np.array([seed % 2**64], dtype=np.uint64)
    for byte in label.encode():
        digest = _mix(digest ^ np.uint64(byte))
    return int(digest[0])


def _mix(x: Words) -> Words:
    """Add the golden gamma and apply splitmix64's finalizer, modulo 2**64."""
    x = x + _GAMMA
    x = (x ^ (x >> np.uint64(30))) * _MIX_1
    x = (x ^ (x >> np.uint64(27))) * _MIX_2
    return x ^ (x >> np.uint64(31))
