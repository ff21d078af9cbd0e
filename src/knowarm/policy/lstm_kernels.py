"""LSTM kernels: the element-wise work of one LSTM step, forward and backward, on the CPU.

PyTorch needs a dozen small operations between two matrix products of an LSTM; each reads and
writes the whole batch, and calling it costs as much as its arithmetic. One compiled loop over the
cells takes half the time.
"""

import numpy as np
from numpy.typing import NDArray

from knowarm.compiling import njit

Floats = NDArray[np.float32]

_ONE, _TWO, _HALF = np.float32(1), np.float32(2), np.float32(0.5)
_LARGEST = np.float32(87)
"""Bound of the exponent: exp of it and of its negative are normal float32 numbers."""
_PER_LN2 = np.float32(1 / np.log(2))
# ln 2 as a sum of two parts: an integer times the first part is exact in float32.
_LN2_HIGH, _LN2_LOW = np.float32(0.693359375), np.float32(np.log(2) - 0.693359375)
_C3, _C4, _C5, _C6, _C7 = (np.float32(1 / n) for n in (6, 24, 120, 720, 5040))


@njit(inline="always")
def _exp(x: np.float32) -> np.float32:
    """Compute exp(x) by powers of two and a Taylor polynomial; relative error 2e-7."""
    x = min(max(x, -_LARGEST), _LARGEST)
    whole = np.floor(x * _PER_LN2 + _HALF)
    r = x - whole * _LN2_HIGH - whole * _LN2_LOW
    tail = _C3 + r * (_C4 + r * (_C5 + r * (_C6 + r * _C7)))
    power = np.int32((np.int32(whole) + np.int32(127)) << np.int32(23)).view(np.float32)
    return (_ONE + r + r * r * (_HALF + r * tail)) * power


@njit(inline="always")
def _sigmoid(x: np.float32) -> np.float32:
    return _ONE / (_ONE + _exp(-x))


@njit(inline="always")
def _tanh(x: np.float32) -> np.float32:
    return _ONE - _TWO / (_ONE + _exp(_TWO * x))


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def forward_step(
    t: int,
    added: Floats,
    keep: Floats,
    gates: Floats,
    c_in: Floats,
    c_tanh: Floats,
    hidden: Floats,
    h: Floats,
    c: Floats,
) -> None:
    """Compute step t in place; all arrays are contiguous float32.

    Read are ``added`` (B, 4H), recurrent part of the gates, and ``keep`` (T, B, 1), 0 where an
    episode starts, else 1. ``gates`` (T, B, 4H) turn from their input part into their activations.
    Written at t (T, B, H): ``c_in``, masked cell state before the step, ``c_tanh``, tanh of the one
    after it, and ``hidden``. ``h`` (B, H) becomes the hidden state, masked for the next step except
    after the last; ``c`` (B, H) the cell state.
    """
    steps, batch, size = hidden.shape
    for b in range(batch):
        kept = keep[t, b, 0]
        next_kept = keep[t + 1, b, 0] if t + 1 < steps else _ONE
        gate, more, cell = gates[t, b], added[b], c[b]
        before, squashed, out, next_h = c_in[t, b], c_tanh[t, b], hidden[t, b], h[b]
        # Short loops over few arrays: only these are vectorized by the compiler.
        for j in range(2 * size):
            gate[j] = _sigmoid(gate[j] + more[j])
        for j in range(2 * size, 3 * size):
            gate[j] = _tanh(gate[j] + more[j])
        for j in range(3 * size, 4 * size):
            gate[j] = _sigmoid(gate[j] + more[j])
        for j in range(size):
            before[j] = cell[j] * kept
            cell[j] = gate[size + j] * before[j] + gate[j] * gate[2 * size + j]
        for j in range(size):
            squashed[j] = _tanh(cell[j])
        for j in range(size):
            out[j] = gate[3 * size + j] * squashed[j]
            next_h[j] = out[j] * next_kept


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def backward_step(
    t: int,
    d_next: Floats,
    d_hidden: Floats,
    keep: Floats,
    gates: Floats,
    c_in: Floats,
    c_tanh: Floats,
    d_gates: Floats,
    dc: Floats,
) -> None:
    """Compute the backward pass of step t in place; arrays are those of `forward_step`.

    Read are ``d_next`` (B, H) and ``d_hidden`` (T, B, H), gradients of ``h`` and ``hidden``.
    Written: ``d_gates`` (B, 4H), gradient of the gates before their activation functions, and
    ``dc`` (B, H), from the gradient of the cell state after the step to that before it.
    """
    steps, batch, size = d_hidden.shape
    for b in range(batch):
        kept = keep[t, b, 0]
        next_kept = keep[t + 1, b, 0] if t + 1 < steps else _ONE
        gate, before, squashed = gates[t, b], c_in[t, b], c_tanh[t, b]
        above, after, d_gate, d_cell = d_hidden[t, b], d_next[b], d_gates[b], dc[b]
        for j in range(size):
            dh = above[j] + after[j] * next_kept
            o, y = gate[3 * size + j], squashed[j]
            d_gate[3 * size + j] = dh * y * o * (_ONE - o)
            d_cell[j] += dh * o * (_ONE - y * y)
        for j in range(size):
            i, g = gate[j], gate[2 * size + j]
            d_gate[j] = d_cell[j] * g * i * (_ONE - i)
            d_gate[2 * size + j] = d_cell[j] * i * (_ONE - g * g)
        for j in range(size):
            f = gate[size + j]
            d_gate[size + j] = d_cell[j] * before[j] * f * (_ONE - f)
            d_cell[j] *= f * kept
