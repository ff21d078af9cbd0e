"""Counter-based random numbers: uniform draws by stream, episode and draw number.

A draw is a hash of its three numbers, so any episodes of any streams can be drawn in one batch, in
any order, and the state of a stream is two integers. The hash is
splitmix64's finalizer (Steele, Lea and Flood 2014) applied to each number in turn.
"""

import numpy as np

from knowarm.world.arrays import Array, array_namespace

# Signed constants, because torch cannot shift unsigned numbers; modulo 2**64 nothing changes.
_GAMMA = 0x9E3779B97F4A7C15 - 2**64
_MIX_1 = 0xBF58476D1CE4E5B9 - 2**64
_MIX_2 = 0x94D049BB133111EB - 2**64


def uniforms(streams: Array, episodes: Array, count: int) -> Array:
    """Draw the uniforms of episodes.

    Args:
        streams: seed of each episode's stream, (n,) uint64, or int64 with the same bits.
        episodes: index of the episode within its stream, (n,) likewise.
        count: numbers drawn per episode.

    Returns:
        (n, count) float64 in [0, 1), the same numbers from NumPy and torch.
    """
    xp = array_namespace(streams, episodes)
    streams, episodes = xp.astype(streams, xp.int64), xp.astype(episodes, xp.int64)
    key = _mix(_mix(streams) ^ episodes)
    draws = xp.arange(count, dtype=xp.int64, device=streams.device)
    bits = _mix(key[:, None] ^ _mix(draws)[None, :])
    return xp.astype(_shifted(bits, 11), xp.float64) * 2.0**-53


def derive(seed: int, label: str) -> int:
    """Derive the seed of a stream that is unrelated to the streams seed, seed + 1, ...

    Args:
        seed: any integer.
        label: purpose of the stream, as "evaluation".

    Returns:
        An integer in [0, 2**64).
    """
    digest = np.array([seed % 2**64], dtype=np.uint64).view(np.int64)
    for byte in label.encode():
        digest = _mix(digest ^ byte)
    return int(digest[0]) % 2**64


def _mix(x: Array) -> Array:
    """Add the golden gamma and apply splitmix64's finalizer, modulo 2**64, to int64 numbers."""
    x = x + _GAMMA
    x = (x ^ _shifted(x, 30)) * _MIX_1
    x = (x ^ _shifted(x, 27)) * _MIX_2
    return x ^ _shifted(x, 31)


def _shifted(x: Array, bits: int) -> Array:
    """Shift int64 numbers right and fill with zeros, as if they were unsigned."""
    return (x >> bits) & ((1 << (64 - bits)) - 1)
