"""Input projections (T, B, 4H) and a start state go in; hidden states (T, B, H) come out."""

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from knowarm.policy.lstm_cell import backward_step, forward_step


class MaskedLSTM(torch.autograd.Function):
    """An LSTM over T steps whose state is multiplied by ``keep`` before every step.

    Same equations and gate order (input, forget, cell, output) as ``torch.nn.LSTM``::

        i, f, o = sigmoid(...)   g = tanh(...)   of   x_t W_ih' + b + keep_t h_{t-1} W_hh'
        c_t = f * keep_t c_{t-1} + i * g         h_t = o * tanh(c_t)

    PyTorch's own kernel knows no masks inside a sequence, and a Python loop under autograd
    multiplies weight gradients T times. Here each weight gradient is one product, and what happens
    to a cell between two products is one loop (`lstm_cell`).

    Matrix products take the type of ``projected`` (float32, or bfloat16 for speed); everything
    else, the cell above all, stays in the type of ``weight_hh``.
    """

    @staticmethod
    def forward(
        ctx: Any, projected: Tensor, weight_hh: Tensor, h: Tensor, c: Tensor, keep: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Run the recursion.

        Args:
            ctx: where what the backward pass needs is kept.
            projected: (T, B, 4H) input part of the gates, biases included.
            weight_hh: (4H, H).
            h: (B, H) start state.
            c: (B, H) start cell.
            keep: (T, B, 1) 1.0, or 0.0 where an episode starts.

        Returns:
            hidden states (T, B, H), last hidden state (B, H), last cell (B, H).
        """
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
