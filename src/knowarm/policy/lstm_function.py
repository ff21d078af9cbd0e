"""Input projections (T, B, 4H) and a start state go in; hidden states (T, B, H) come out."""

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable


class MaskedLSTM(torch.autograd.Function):
    """An LSTM over T steps whose state is multiplied by ``keep`` before every step.

    Same equations and gate order (input, forget, cell, output) as ``torch.nn.LSTM``::

        i, f, o = sigmoid(...)   g = tanh(...)   of   x_t W_ih' + b + keep_t h_{t-1} W_hh'
        c_t = f * keep_t c_{t-1} + i * g         h_t = o * tanh(c_t)

    PyTorch's own kernel knows no masks inside a sequence, and a Python loop under autograd
    multiplies weight gradients T times. Here the backward pass computes every factor that does
    not depend on the recursion for all T at once, and each weight gradient as one product.

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
        gates = projected.to(full, copy=True)
        h_in = projected.new_empty(steps, batch, size)
        c_in = torch.empty(steps, batch, size, dtype=full)
        c_tanh, hidden = torch.empty_like(c_in), torch.empty_like(c_in)
        weight = weight_hh.to(low)
        recurrent = weight.t()
        for t in range(steps):
            h_in[t] = h * keep[t]
            torch.mul(c, keep[t], out=c_in[t])
            gate = gates[t]
            if low == full:
                gate.addmm_(h_in[t], recurrent)
            else:
                gate.add_(torch.mm(h_in[t], recurrent))
            gate[:, : 2 * size].sigmoid_()
            gate[:, 2 * size : 3 * size].tanh_()
            gate[:, 3 * size :].sigmoid_()
            i, f, g, o = gate.split(size, 1)
            c = torch.addcmul(f * c_in[t], i, g)
            torch.tanh(c, out=c_tanh[t])
            h = torch.mul(o, c_tanh[t], out=hidden[t])
        ctx.save_for_backward(gates, weight, h_in, c_in, c_tanh, keep)
        return hidden, h.clone(), c

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, None]:
        """Return the gradients of all inputs but ``keep``."""
        d_hidden, dh, dc = grads
        gates, weight, h_in, c_in, c_tanh, keep = ctx.saved_tensors
        steps, batch, size = h_in.shape
        i, f, g, o = gates.view(steps, batch, 4, size).unbind(2)
        # d(gate before its nonlinearity) per d(cell), and for the output gate per d(hidden).
        factor = torch.empty_like(gates).view(steps, batch, 4, size)
        torch.mul(g * i, 1 - i, out=factor[:, :, 0])
        torch.mul(c_in * f, 1 - f, out=factor[:, :, 1])
        torch.mul(i, 1 - g * g, out=factor[:, :, 2])
        torch.mul(c_tanh * o, 1 - o, out=factor[:, :, 3])
        through_tanh = o * (1 - c_tanh * c_tanh)
        forget = f * keep
        for t in reversed(range(steps)):
            dh = dh + d_hidden[t]
            dc = torch.addcmul(dc, dh, through_tanh[t])
            d_gate = factor[t]
            d_gate[:, :3].mul_(dc[:, None])
            d_gate[:, 3].mul_(dh)
            dc = dc * forget[t]
            low = d_gate.view(batch, 4 * size).to(weight.dtype)
            dh = torch.mm(low, weight).to(keep.dtype).mul_(keep[t])
        d_projected = factor.view(steps, batch, 4 * size).to(weight.dtype)
        d_weight = d_projected.view(-1, 4 * size).t() @ h_in.view(-1, size)
        return d_projected, d_weight.to(keep.dtype), dh, dc, None
