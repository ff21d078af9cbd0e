"""Masked LSTM: a single-layer LSTM whose state is reset where an episode starts, and its kernels.

PyTorch needs a dozen small operations between two matrix products of an LSTM; each reads and
writes the whole batch, and calling it costs as much as its arithmetic. One compiled loop over the
cells takes half the time.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from numpy import float32, int32
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from knowarm.compiling import njit

Singles = NDArray[float32]

_ONE = float32(1)
_TWO = float32(2)
_HALF = float32(0.5)
_LARGEST = float32(87)
"""Bound of the exponent: exp of it and of its negative are normal float32 numbers."""
_PER_LN2 = float32(1 / np.log(2))
# ln 2 as a sum of two parts: an integer times the first part is exact in float32.
_LN2_HIGH = float32(0.693359375)
_LN2_LOW = float32(np.log(2) - 0.693359375)
# Coefficients 1 / n! of the Taylor polynomial.
_C3, _C4, _C5, _C6, _C7 = (float32(1 / math.factorial(n)) for n in range(3, 8))

_inlined: Callable[..., Any] = njit(inline="always")
_kernel: Callable[..., Any] = njit(
    cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}
)


@_inlined
def _exp(x: float32) -> float32:
    """Compute exp(x) by powers of two and a Taylor polynomial; relative error 2e-7."""
    x = min(max(x, -_LARGEST), _LARGEST)
    whole = np.floor(x * _PER_LN2 + _HALF)
    r = x - whole * _LN2_HIGH - whole * _LN2_LOW
    tail = _C3 + r * (_C4 + r * (_C5 + r * (_C6 + r * _C7)))
    power = int32((int32(whole) + int32(127)) << int32(23)).view(float32)
    return (_ONE + r + r * r * (_HALF + r * tail)) * power


@_inlined
def _sigmoid(x: float32) -> float32:
    return _ONE / (_ONE + _exp(-x))


@_inlined
def _tanh(x: float32) -> float32:
    return _ONE - _TWO / (_ONE + _exp(_TWO * x))


@_kernel
def forward_step(
    t: int,
    added: Singles,
    masks: Singles,
    gates: Singles,
    c_in: Singles,
    c_tanh: Singles,
    hidden: Singles,
    h: Singles,
    c: Singles,
) -> None:
    """Compute step t in place; all arrays are contiguous float32.

    Read are ``added`` (B, 4, H), recurrent part of the gates, and ``masks`` (T + 1, B), 0 where an
    episode starts, else 1. ``gates`` (T, B, 4, H) turn from their input part into their
    activations. Written at t (T, B, H): ``c_in``, masked cell state before the step, ``c_tanh``,
    tanh of the one after it, and ``hidden``. ``h`` (B, H) becomes the hidden state, masked for the
    next step; ``c`` (B, H) the cell state.
    """
    _, batch, size = hidden.shape
    for b in range(batch):
        mask = masks[t, b]
        next_mask = masks[t + 1, b]
        gate = gates[t, b]
        recurrent = added[b]
        cell = c[b]
        before = c_in[t, b]
        squashed = c_tanh[t, b]
        out = hidden[t, b]
        next_h = h[b]
        # Short loops over few arrays: only these are vectorized by the compiler.
        for k in (0, 1, 3):
            for j in range(size):
                gate[k, j] = _sigmoid(gate[k, j] + recurrent[k, j])
        for j in range(size):
            gate[2, j] = _tanh(gate[2, j] + recurrent[2, j])
        for j in range(size):
            before[j] = cell[j] * mask
            cell[j] = gate[1, j] * before[j] + gate[0, j] * gate[2, j]
        for j in range(size):
            squashed[j] = _tanh(cell[j])
        for j in range(size):
            out[j] = gate[3, j] * squashed[j]
            next_h[j] = out[j] * next_mask


@_kernel
def backward_step(
    t: int,
    d_next: Singles,
    d_hidden: Singles,
    masks: Singles,
    gates: Singles,
    c_in: Singles,
    c_tanh: Singles,
    d_gates: Singles,
    dc: Singles,
) -> None:
    """Compute the backward pass of step t in place; arrays are those of `forward_step`.

    Read are ``d_next`` (B, H) and ``d_hidden`` (T, B, H), gradients of ``h`` and ``hidden``.
    Written: ``d_gates`` (B, 4, H), gradient of the gates before their activation functions, and
    ``dc`` (B, H), from the gradient of the cell state after the step to that before it.
    """
    _, batch, size = d_hidden.shape
    for b in range(batch):
        mask = masks[t, b]
        next_mask = masks[t + 1, b]
        gate = gates[t, b]
        before = c_in[t, b]
        squashed = c_tanh[t, b]
        d_out = d_hidden[t, b]
        d_next_h = d_next[b]
        d_gate = d_gates[b]
        d_cell = dc[b]
        for j in range(size):
            dh = d_out[j] + d_next_h[j] * next_mask
            o = gate[3, j]
            y = squashed[j]
            d_gate[3, j] = dh * y * o * (_ONE - o)
            d_cell[j] += dh * o * (_ONE - y * y)
        for j in range(size):
            i = gate[0, j]
            g = gate[2, j]
            d_gate[0, j] = d_cell[j] * g * i * (_ONE - i)
            d_gate[2, j] = d_cell[j] * i * (_ONE - g * g)
        for j in range(size):
            f = gate[1, j]
            d_gate[1, j] = d_cell[j] * before[j] * f * (_ONE - f)
            d_cell[j] *= f * mask


State = tuple[Tensor, Tensor]
"""Recurrent state: hidden state and cell state, each (B, H)."""


class MaskedLSTM(nn.Module):
    """A single-layer LSTM whose state (hidden and cell, size H) is zeroed where an episode starts.

    Parameters have the names, shapes and gate order of ``torch.nn.LSTMCell``. The module stores
    no state: it is an argument and a return value.

    Attributes:
        projected: passes on the input part of the gates, for hooks that want its gradient.
    """

    def __init__(self, inputs: int, hidden: int) -> None:
        super().__init__()
        self.hidden = hidden
        self.weight_ih = nn.Parameter(torch.empty(4 * hidden, inputs))
        self.weight_hh = nn.Parameter(torch.empty(4 * hidden, hidden))
        self.bias_ih = nn.Parameter(torch.zeros(4 * hidden))
        self.bias_hh = nn.Parameter(torch.zeros(4 * hidden))
        self.projected = nn.Identity()

    def initial_state(self, batch: int) -> State:
        """Return a state of zeros for ``batch`` environments."""
        zeros = self.weight_hh.new_zeros(batch, self.hidden)
        return zeros, zeros.clone()

    def step(
        self,
        x: Tensor,
        state: State,
        episode_start: Tensor,
    ) -> tuple[Tensor, State]:
        """Advance by one step from inputs (B, inputs) and the state after the previous step.

        ``episode_start`` (B,) bool is true where ``x`` is the first input of its episode.

        Returns:
            Hidden state (B, H) and the next state.
        """
        keep = (~episode_start).to(x.dtype)[:, None]
        return self._advance(self._project(x), state, keep)

    def forward(
        self,
        x: Tensor,
        state: State,
        episode_start: Tensor,
    ) -> tuple[Tensor, State]:
        """Advance by T steps; equals T calls of `step`, on the CPU with a faster backward pass.

        Arguments are those of `step` with a leading axis T; ``state`` precedes the first step.

        Returns:
            Hidden states (T, B, H) and the state after the last step.
        """
        weight = self.weight_hh
        keep = (~episode_start).to(weight.dtype)[:, :, None]
        projected = self.projected(self._project(x))
        if _has_kernels(weight):
            hidden, h, c = MaskedLSTMFunction.apply(projected, weight, *state, keep)
            return hidden, (h, c)
        outputs = []
        for gates, mask in zip(projected, keep, strict=True):
            output, state = self._advance(gates, state, mask)
            outputs.append(output)
        return torch.stack(outputs), state

    def _advance(
        self,
        projected: Tensor,
        state: State,
        keep: Tensor,
    ) -> tuple[Tensor, State]:
        """Advance by one step from the input part of the gates (B, 4H) and a mask (B, 1)."""
        h = state[0] * keep
        c = state[1] * keep
        gates = projected + F.linear(h, self.weight_hh)
        i, f, g, o = gates.to(c.dtype).chunk(4, 1)
        c = torch.sigmoid(f) * c + torch.sigmoid(i) * torch.tanh(g)
        h = torch.sigmoid(o) * torch.tanh(c)
        return h, (h, c)

    def _project(self, x: Tensor) -> Tensor:
        return F.linear(x, self.weight_ih, self.bias_ih + self.bias_hh)


class MaskedLSTMFunction(torch.autograd.Function):
    """LSTM recursion over T steps that multiplies the state by ``keep`` before every step.

    Equations and gate order (input, forget, cell, output) are those of ``torch.nn.LSTM``::

        i, f, o = sigmoid(...)   g = tanh(...)   of   x_t W_ih' + b + keep_t h_{t-1} W_hh'
        c_t = f * keep_t c_{t-1} + i * g         h_t = o * tanh(c_t)

    PyTorch's fused LSTM has no masks within a sequence, and a Python loop under autograd
    computes T products per weight gradient. Here each weight gradient is one product, and the
    element-wise work between two products is one compiled loop (`knowarm.policy.lstm`).

    Matrix products have the dtype of ``projected`` (float32, or bfloat16 for speed); everything
    else, the cell state in particular, is float32.
    """

    @staticmethod
    def forward(
        ctx: Any,
        projected: Tensor,
        weight_hh: Tensor,
        h: Tensor,
        c: Tensor,
        keep: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Run the recursion from the state ``h``, ``c`` (B, H); ``ctx`` is read by `backward`.

        ``projected`` (T, B, 4H) is the input part of the gates, biases included; ``keep`` (T, B, 1)
        is 1.0, or 0.0 where an episode starts. Returns hidden states (T, B, H), last hidden state
        and last cell state (B, H).
        """
        gates = projected.to(weight_hh.dtype, copy=True).contiguous()
        gates = gates.unflatten(2, (4, -1))
        h_in = projected.new_empty(len(projected), *h.shape)
        c_in = torch.empty_like(h_in, dtype=gates.dtype)
        c_tanh = torch.empty_like(c_in)
        hidden = torch.empty_like(c_in)
        added = torch.zeros_like(gates[0])
        weight = weight_hh.to(projected.dtype)
        recurrent = weight.t()
        h = h * keep[0]
        c = c.clone()
        tensors = (added, _masks(keep), gates, c_in, c_tanh, hidden, h, c)
        arrays = [tensor.numpy() for tensor in tensors]
        # Where every step starts an episode, the recurrent products are zeros.
        ctx.remembers = bool(keep.any())
        for t, h_t in enumerate(h_in):
            h_t.copy_(h)
            if ctx.remembers:
                added.copy_(torch.mm(h_t, recurrent).view_as(added))
            forward_step(t, *arrays)
        ctx.save_for_backward(gates, weight, h_in, c_in, c_tanh, keep)
        return hidden, h, c

    @staticmethod
    @once_differentiable
    def backward(
        ctx: Any, *grads: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, None]:
        """Return the gradients of all inputs but ``keep``."""
        d_hidden, dh, dc = grads
        gates, weight, h_in, c_in, c_tanh, keep = ctx.saved_tensors
        d_projected = torch.empty_like(gates.flatten(2), dtype=weight.dtype)
        d_gates = torch.empty_like(gates[0])
        d_next = dh.clone()
        dc = dc.clone()
        d_hidden = d_hidden.contiguous()
        tensors = (d_next, d_hidden, _masks(keep), gates, c_in, c_tanh, d_gates, dc)
        arrays = [tensor.numpy() for tensor in tensors]
        for t in reversed(range(len(d_projected))):
            backward_step(t, *arrays)
            d_projected[t] = d_gates.flatten(1)
            if t or ctx.needs_input_grad[2]:
                d_next.copy_(torch.mm(d_projected[t], weight))
        d_weight = torch.zeros_like(weight)
        if ctx.remembers:
            d_weight = d_projected.flatten(0, 1).t() @ h_in.flatten(0, 1)
        return d_projected, d_weight.to(keep.dtype), d_next * keep[0], dc, None


def _masks(keep: Tensor) -> Tensor:
    """Return masks (T, B, 1) as (T + 1, B); none follows the last step, so the last ones are 1."""
    return F.pad(keep[:, :, 0], (0, 0, 0, 1), value=1.0)


def _has_kernels(weight: Tensor) -> bool:
    """Tell whether the compiled loops compute with these parameters."""
    return weight.device.type == "cpu" and weight.dtype == torch.float32
