"""Masked LSTM: a single-layer LSTM whose state is reset where an episode starts."""

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from knowarm.policy.lstm_kernels import backward_step, forward_step

State = tuple[Tensor, Tensor]
"""Recurrent state: hidden state and cell state, each (B, H)."""


class MaskedLSTM(nn.Module):
    """A single-layer LSTM whose state (hidden and cell, size H) is zeroed where an episode starts.

    Parameters have the names, shapes and gate order of ``torch.nn.LSTMCell``. The module stores
    no state: it is an argument and a return value.
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
        """Advance by one step from inputs (B, inputs) and the state after the previous step.

        ``episode_start`` (B,) bool is true where ``x`` is the first input of its episode.

        Returns:
            Hidden state (B, H) and the next state.
        """
        return self._advance(self._project(x), state, (~episode_start).to(x.dtype)[:, None])

    def unroll(self, x: Tensor, state: State, episode_start: Tensor) -> tuple[Tensor, State]:
        """Advance by T steps; equals T calls of `step`, on the CPU with a faster backward pass.

        Arguments are those of `step` with a leading axis T; ``state`` precedes the first step.

        Returns:
            Hidden states (T, B, H) and the state after the last step.
        """
        keep = (~episode_start).to(self.weight_hh.dtype)[:, :, None]
        projected = self._project(x)
        if _has_kernels(self.weight_hh):
            hidden, h, c = MaskedLSTMFunction.apply(projected, self.weight_hh, *state, keep)
            return hidden, (h, c)
        outputs = []
        for gates, mask in zip(projected, keep, strict=True):
            output, state = self._advance(gates, state, mask)
            outputs.append(output)
        return torch.stack(outputs), state

    def _advance(self, projected: Tensor, state: State, keep: Tensor) -> tuple[Tensor, State]:
        """Advance by one step from the input part of the gates (B, 4H) and a mask (B, 1)."""
        h, c = state[0] * keep, state[1] * keep
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
    element-wise work between two products is one compiled loop (`knowarm.policy.lstm_kernels`).

    Matrix products have the dtype of ``projected`` (float32, or bfloat16 for speed); everything
    else, the cell state in particular, is float32.
    """

    @staticmethod
    def forward(
        ctx: Any, projected: Tensor, weight_hh: Tensor, h: Tensor, c: Tensor, keep: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Run the recursion from the state ``h``, ``c`` (B, H); ``ctx`` is read by `backward`.

        ``projected`` (T, B, 4H) is the input part of the gates, biases included; ``keep`` (T, B, 1)
        is 1.0, or 0.0 where an episode starts. Returns hidden states (T, B, H), last hidden state
        and last cell state (B, H).
        """
        steps, batch, _ = projected.shape
        size = weight_hh.shape[1]
        gates = projected.to(weight_hh.dtype, copy=True).contiguous()
        h_in = projected.new_empty(steps, batch, size)
        c_in = gates.new_empty(steps, batch, size)
        c_tanh, hidden = torch.empty_like(c_in), torch.empty_like(c_in)
        weight = weight_hh.to(projected.dtype)
        recurrent, added = weight.t(), torch.empty_like(gates[0])
        h, c = h * keep[0], c.clone()
        arrays = [x.numpy() for x in (added, keep, gates, c_in, c_tanh, hidden, h, c)]
        for t, h_t in enumerate(h_in.unbind()):
            h_t.copy_(h)
            added.copy_(torch.mm(h_t, recurrent))
            forward_step(t, *arrays)
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
        tensors = (d_next, d_hidden.contiguous(), keep, gates, c_in, c_tanh, d_gates, dc)
        arrays = [x.numpy() for x in tensors]
        for t, low in reversed(list(enumerate(d_projected.unbind()))):
            backward_step(t, *arrays)
            low.copy_(d_gates)
            d_next.copy_(torch.mm(low, weight))
        d_weight = d_projected.view(-1, 4 * size).t() @ h_in.view(-1, size)
        return d_projected, d_weight.to(keep.dtype), d_next * keep[0], dc, None


def _has_kernels(weight: Tensor) -> bool:
    """Tell whether the compiled loops compute with these parameters."""
    return weight.device.type == "cpu" and weight.dtype == torch.float32
