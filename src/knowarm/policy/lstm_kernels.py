"""LSTM kernels: the element-wise work of one LSTM step, forward and backward.

PyTorch needs a dozen small operations between two matrix products of an LSTM; each reads and
writes the whole batch, and launching it costs as much as its arithmetic. On the CPU and in float32
one compiled loop over the cells takes half the time; elsewhere PyTorch's operations are used.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

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


def forward_step(
    added: Tensor,
    keep: Tensor,
    gates: Tensor,
    c_in: Tensor,
    c_tanh: Tensor,
    hidden: Tensor,
    h: Tensor,
    c: Tensor,
) -> Callable[[int], None]:
    """Return a function that computes step t in place; tensors are contiguous and of one dtype.

    Args:
        added: (B, 4H) recurrent part of the gates.
        keep: (T, B, 1) 1, or 0 where an episode starts.
        gates: (T, B, 4H); read at t: input part of the gates; written: their activations.
        c_in: (T, B, H) written at t: masked cell state before the step.
        c_tanh: (T, B, H) written at t: tanh of the cell state after the step.
        hidden: (T, B, H) written at t: hidden state after the step.
        h: (B, H) written: hidden state masked for the next step; unmasked after the last step.
        c: (B, H) cell state, updated.
    """
    tensors = (added, keep, gates, c_in, c_tanh, hidden, h, c)
    if _can_compile(gates):
        arrays = [x.numpy() for x in tensors]
        return lambda t: _forward_loop(t, *arrays)
    return partial(_forward_operations, tensors)


def backward_step(
    d_next: Tensor,
    d_hidden: Tensor,
    keep: Tensor,
    gates: Tensor,
    c_in: Tensor,
    c_tanh: Tensor,
    d_gates: Tensor,
    dc: Tensor,
) -> Callable[[int], None]:
    """Return a function that computes the backward pass of step t in place.

    Args:
        d_next: (B, H) gradient of the ``h`` that step t wrote.
        d_hidden: (T, B, H) gradient of the returned hidden states.
        keep: (T, B, 1) as in `forward_step`.
        gates: (T, B, 4H) as written by `forward_step`.
        c_in: (T, B, H) as written by `forward_step`.
        c_tanh: (T, B, H) as written by `forward_step`.
        d_gates: (B, 4H) written: gradient of the gates before their activation functions.
        dc: (B, H) gradient of the cell state after the step; written: before the step.
    """
    tensors = (d_next, d_hidden, keep, gates, c_in, c_tanh, d_gates, dc)
    if _can_compile(gates):
        arrays = [x.numpy() for x in tensors]
        return lambda t: _backward_loop(t, *arrays)
    return partial(_backward_operations, tensors)


def _can_compile(tensor: Tensor) -> bool:
    return tensor.device.type == "cpu" and tensor.dtype == torch.float32


def _next_keep(keep: Tensor, t: int) -> Tensor:
    """Return the mask of step t + 1, ones after the last step: (B, 1)."""
    return keep[t + 1] if t + 1 < len(keep) else torch.ones_like(keep[t])


def _forward_operations(tensors: tuple[Tensor, ...], t: int) -> None:
    added, keep, gates, c_in, c_tanh, hidden, h, c = tensors
    size = c.shape[1]
    gate = gates[t].add_(added)
    gate[:, : 2 * size].sigmoid_()
    gate[:, 2 * size : 3 * size].tanh_()
    gate[:, 3 * size :].sigmoid_()
    i, f, g, o = gate.split(size, 1)
    torch.mul(c, keep[t], out=c_in[t])
    torch.mul(f, c_in[t], out=c).addcmul_(i, g)
    torch.tanh(c, out=c_tanh[t])
    torch.mul(o, c_tanh[t], out=hidden[t])
    torch.mul(hidden[t], _next_keep(keep, t), out=h)


def _backward_operations(tensors: tuple[Tensor, ...], t: int) -> None:
    d_next, d_hidden, keep, gates, c_in, c_tanh, d_gates, dc = tensors
    size = dc.shape[1]
    i, f, g, o = gates[t].split(size, 1)
    y = c_tanh[t]
    dh = torch.addcmul(d_hidden[t], d_next, _next_keep(keep, t))
    dc.addcmul_(dh * o, 1 - y * y)
    torch.mul(dc * g * i, 1 - i, out=d_gates[:, :size])
    torch.mul(dc * c_in[t] * f, 1 - f, out=d_gates[:, size : 2 * size])
    torch.mul(dc * i, 1 - g * g, out=d_gates[:, 2 * size : 3 * size])
    torch.mul(dh * y * o, 1 - o, out=d_gates[:, 3 * size :])
    dc.mul_(f * keep[t])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _forward_loop(
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
def _backward_loop(
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
