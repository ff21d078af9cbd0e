"""Masked LSTM: a single-layer LSTM whose state is reset where an episode starts."""

import warnings
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from knowarm.policy.lstm_kernels import backward_step, forward_step

State = tuple[Tensor, Tensor]
"""Recurrent state: hidden state and cell state, each (B, H)."""


class MaskedLSTM(nn.Module):
    """A single-layer LSTM whose state is zeroed where an episode starts.

    Parameters have the names, shapes and gate order of ``torch.nn.LSTMCell``. The module stores
    no state: it is an argument and a return value.

    Args:
        inputs: number of inputs.
        hidden: size H of hidden and cell state.
    """

    def __init__(self, inputs: int, hidden: int) -> None:
        super().__init__()
        self.hidden = hidden
        self.weight_ih = nn.Parameter(torch.empty(4 * hidden, inputs))
        self.weight_hh = nn.Parameter(torch.empty(4 * hidden, hidden))
        self.bias_ih = nn.Parameter(torch.zeros(4 * hidden))
        self.bias_hh = nn.Parameter(torch.zeros(4 * hidden))

    def initial_state(self, batch: int) -> State:
        """Return a state of zeros for ``batch`` environments."""
        zeros = self.weight_hh.new_zeros(batch, self.hidden)
        return zeros, zeros.clone()

    def step(self, x: Tensor, state: State, episode_start: Tensor) -> tuple[Tensor, State]:
        """Advance by one step.

        Args:
            x: (B, inputs).
            state: state after the previous step.
            episode_start: (B,) bool, true where ``x`` is the first input of its episode.

        Returns:
            Hidden state (B, H) and the next state.
        """
        keep = (~episode_start).to(x.dtype)[:, None]
        h, c = state[0] * keep, state[1] * keep
        gates = self._project(x) + F.linear(h, self.weight_hh)
        i, f, g, o = gates.to(c.dtype).chunk(4, 1)
        c = torch.sigmoid(f) * c + torch.sigmoid(i) * torch.tanh(g)
        h = torch.sigmoid(o) * torch.tanh(c)
        return h, (h, c)

    def unroll(self, x: Tensor, state: State, episode_start: Tensor) -> tuple[Tensor, State]:
        """Advance by T steps; equals T calls of `step`, with a faster backward pass.

        Args:
            x: (T, B, inputs).
            state: state before the first step.
            episode_start: (T, B) bool.

        Returns:
            Hidden states (T, B, H) and the state after the last step.
        """
        keep = (~episode_start).to(self.weight_hh.dtype)[:, :, None]
        projected = self._project_aligned(x) if _uses_triton(x) else self._project(x)
        hidden, h, c = MaskedLSTMFunction.apply(projected, self.weight_hh, *state, keep)
        return hidden, (h, c)

    def _bias(self) -> Tensor:
        return self.bias_ih + self.bias_hh

    def _project(self, x: Tensor) -> Tensor:
        return F.linear(x, self.weight_ih, self._bias())

    def _project_aligned(self, x: Tensor) -> Tensor:
        """Compute `_project` with sizes padded to multiples of eight; see `lstm_triton`."""
        gates, inputs = self.weight_ih.shape
        more, missing = -gates % 8, -inputs % 8
        weight = F.pad(self.weight_ih, (0, missing, 0, more))
        bias = F.pad(self._bias(), (0, more))
        return F.linear(F.pad(x, (0, missing)), weight, bias)[..., :gates]


class MaskedLSTMFunction(torch.autograd.Function):
    """LSTM recursion over T steps that multiplies the state by ``keep`` before every step.

    Equations and gate order (input, forget, cell, output) are those of ``torch.nn.LSTM``::

        i, f, o = sigmoid(...)   g = tanh(...)   of   x_t W_ih' + b + keep_t h_{t-1} W_hh'
        c_t = f * keep_t c_{t-1} + i * g         h_t = o * tanh(c_t)

    PyTorch's fused LSTM has no masks within a sequence, and a Python loop under autograd
    computes T products per weight gradient. Here each weight gradient is one product, and the
    element-wise work between two products is one loop on the CPU (`knowarm.policy.lstm_kernels`)
    and one kernel on a GPU with Triton (`knowarm.policy.lstm_triton`).

    Matrix products have the dtype of ``projected`` (float32, or bfloat16 for speed); everything
    else, the cell state in particular, has the dtype of ``weight_hh``.
    """

    @staticmethod
    def forward(
        ctx: Any, projected: Tensor, weight_hh: Tensor, h: Tensor, c: Tensor, keep: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Run the recursion.

        Args:
            ctx: stores the tensors of the backward pass.
            projected: (T, B, 4H) input part of the gates, biases included.
            weight_hh: (4H, H).
            h: (B, H) initial hidden state.
            c: (B, H) initial cell state.
            keep: (T, B, 1) 1.0, or 0.0 where an episode starts.

        Returns:
            Hidden states (T, B, H), last hidden state (B, H), last cell state (B, H).
        """
        ctx.fused = _uses_triton(projected)
        if ctx.fused:
            hidden, h, c, saved = _triton().forward(projected, weight_hh, h, c, keep)
            ctx.save_for_backward(*saved, keep)
            return hidden, h, c
        steps, batch, _ = projected.shape
        size = weight_hh.shape[1]
        low, full = projected.dtype, weight_hh.dtype
        gates = projected.to(full, copy=True).contiguous()
        h_in = projected.new_empty(steps, batch, size)
        c_in = gates.new_empty(steps, batch, size)
        c_tanh, hidden = torch.empty_like(c_in), torch.empty_like(c_in)
        weight = weight_hh.to(low)
        recurrent, added = weight.t(), torch.empty_like(gates[0])
        h, c = h * keep[0], c.clone()
        step = forward_step(added, keep, gates, c_in, c_tanh, hidden, h, c)
        for t, h_t in enumerate(h_in.unbind()):
            h_t.copy_(h)
            added.copy_(torch.mm(h_t, recurrent))
            step(t)
        ctx.save_for_backward(gates, weight, h_in, c_in, c_tanh, keep)
        return hidden, h, c

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, None]:
        """Return the gradients of all inputs but ``keep``."""
        d_hidden, dh, dc = grads
        if ctx.fused:
            *saved, keep = ctx.saved_tensors
            return *_triton().backward(saved, keep, *grads), None
        gates, weight, h_in, c_in, c_tanh, keep = ctx.saved_tensors
        size = weight.shape[1]
        d_projected = torch.empty_like(gates, dtype=weight.dtype)
        d_gates, d_next, dc = torch.empty_like(gates[0]), dh.clone(), dc.clone()
        step = backward_step(d_next, d_hidden.contiguous(), keep, gates, c_in, c_tanh, d_gates, dc)
        for t, low in reversed(list(enumerate(d_projected.unbind()))):
            step(t)
            low.copy_(d_gates)
            d_next.copy_(torch.mm(low, weight))
        d_weight = d_projected.view(-1, 4 * size).t() @ h_in.view(-1, size)
        return d_projected, d_weight.to(keep.dtype), d_next * keep[0], dc, None


def _uses_triton(x: Tensor) -> bool:
    """Tell whether the recursion over a tensor runs on Triton's kernels."""
    return x.is_cuda and x.dtype != torch.float64 and _triton() is not None


@cache
def _triton() -> Any:
    """Return the module of Triton's kernels, None where they cannot be compiled."""
    if find_spec("triton") is None:
        return None
    module = import_module("knowarm.policy.lstm_triton")
    try:
        module.compile_kernels()
    except Exception as error:  # of Triton, the C compiler or the driver
        warnings.warn(
            f"Triton could not compile the LSTM's kernels ({error}); PyTorch's operations, which "
            "are slower, take their place.",
            RuntimeWarning,
            stacklevel=2,
        )
        return None
    return module
