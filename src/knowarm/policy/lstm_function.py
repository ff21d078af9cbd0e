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
        # All views at once: taking them step by step costs as much as the arithmetic.
        views = zip(
            gates.unbind(), gates[:, :, : 2 * size].unbind(), *_four(gates), keep.unbind(),
            h_in.unbind(), c_in.unbind(), c_tanh.unbind(), hidden.unbind(), strict=True,
        )  # fmt: skip
        for gate, i_and_f, i, f, g, o, kept, h_t, c_t, tanh_t, hidden_t in views:
            torch.mul(h, kept, out=h_t)
            torch.mul(c, kept, out=c_t)
            if low == full:
                gate.addmm_(h_t, recurrent)
            else:
                gate.add_(torch.mm(h_t, recurrent))
            i_and_f.sigmoid_()
            g.tanh_()
            o.sigmoid_()
            c = torch.mul(f, c_t).addcmul_(i, g)
            torch.tanh(c, out=tanh_t)
            h = torch.mul(o, tanh_t, out=hidden_t)
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
        d_gates = factor.view(steps, batch, 4 * size)
        d_projected = (
            d_gates
            if weight.dtype == factor.dtype
            else torch.empty_like(d_gates, dtype=weight.dtype)
        )
        views = zip(
            d_hidden.unbind(), through_tanh.unbind(), d_gates.unbind(),
            factor[:, :, :3].unbind(), factor[:, :, 3].unbind(), forget.unbind(), keep.unbind(),
            d_projected.unbind(), strict=True,
        )  # fmt: skip
        for d_h, tanh_t, d_gate, d_ifg, d_o, forget_t, kept, low in reversed(list(views)):
            dh = dh + d_h
            dc = torch.addcmul(dc, dh, tanh_t)
            d_ifg.mul_(dc[:, None])
            d_o.mul_(dh)
            dc = dc * forget_t
            if d_projected is not d_gates:
                low.copy_(d_gate)
            dh = torch.mul(torch.mm(low, weight), kept)
        d_weight = d_projected.view(-1, 4 * size).t() @ h_in.view(-1, size)
        return d_projected, d_weight.to(keep.dtype), dh, dc, None


def _four(gates: Tensor) -> tuple[tuple[Tensor, ...], ...]:
    """Views of the four gates (T, B, 4H) of every step: 4 tuples of T tensors (B, H)."""
    return tuple(gate.unbind() for gate in gates.chunk(4, 2))
