"""LSTM recursion on a GPU: one Triton kernel for the element-wise work of a step.

Matrix products have sizes padded to multiples of eight with zeros: only these have rows that start
at multiples of 16 bytes, as the fast kernels for bfloat16 need. The numbers of
`knowarm.policy.lstm_kernels` are computed, up to the rounding of exp.

Import this module only where Triton is installed.
"""

import torch
import torch.nn.functional as F
import triton
import triton.language as tl
from torch import Tensor

BLOCK = 256
"""Cells per program of a kernel."""

Saved = tuple[Tensor, Tensor, Tensor, Tensor, Tensor]
"""Gates (T, B, 4H), padded weight (W, D), hidden states before each step (T, B, D), cell states
before each step (T, B, H), and the tanh of those after it (T, B, H)."""


def padded(size: int) -> int:
    """Return the smallest multiple of eight that is at least ``size``."""
    return -(-size // 8) * 8


@triton.jit
def _sigmoid(x):
    return 1 / (1 + tl.exp(-x))


@triton.jit
def _tanh(x):
    return 1 - 2 / (1 + tl.exp(2 * x))


@triton.jit(do_not_specialize=["t"])
def forward_kernel(
    projected, added, keep, gates, c_in, c_tanh, hidden, h_in, c,
    t, steps, batch, size, wide, deep, BLOCK: tl.constexpr,
):  # fmt: skip
    """Compute step t; arguments as in `forward`, ``added`` (B, W)."""
    place = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = place < batch * size
    b, j = place // size, place % size
    row = t * batch + b
    kept = tl.load(keep + row, mask=inside, other=0.0)
    next_kept = tl.load(keep + row + batch, mask=inside & (row + batch < steps * batch), other=0.0)
    own, more = row * 4 * size + j, b * wide + j
    i = tl.load(projected + own, mask=inside, other=0.0).to(tl.float32)
    f = tl.load(projected + own + size, mask=inside, other=0.0).to(tl.float32)
    g = tl.load(projected + own + 2 * size, mask=inside, other=0.0).to(tl.float32)
    o = tl.load(projected + own + 3 * size, mask=inside, other=0.0).to(tl.float32)
    i = _sigmoid(i + tl.load(added + more, mask=inside, other=0.0).to(tl.float32))
    f = _sigmoid(f + tl.load(added + more + size, mask=inside, other=0.0).to(tl.float32))
    g = _tanh(g + tl.load(added + more + 2 * size, mask=inside, other=0.0).to(tl.float32))
    o = _sigmoid(o + tl.load(added + more + 3 * size, mask=inside, other=0.0).to(tl.float32))
    before = tl.load(c + place, mask=inside, other=0.0) * kept
    cell = f * before + i * g
    squashed = _tanh(cell)
    out = o * squashed
    state = row * size + j
    tl.store(gates + own, i, mask=inside)
    tl.store(gates + own + size, f, mask=inside)
    tl.store(gates + own + 2 * size, g, mask=inside)
    tl.store(gates + own + 3 * size, o, mask=inside)
    tl.store(c_in + state, before, mask=inside)
    tl.store(c_tanh + state, squashed, mask=inside)
    tl.store(hidden + state, out, mask=inside)
    tl.store(c + place, cell, mask=inside)
    # A store rounds to the type of its target.
    rest = inside & (row + batch < steps * batch)
    tl.store(h_in + (row + batch) * deep + j, out * next_kept, mask=rest)


@triton.jit(do_not_specialize=["t"])
def backward_kernel(
    d_next, dh, d_hidden, keep, gates, c_in, c_tanh, d_projected, dc,
    t, steps, batch, size, wide, deep, BLOCK: tl.constexpr,
):  # fmt: skip
    """Compute the backward pass of step t; arguments as in `backward`, ``d_next`` (B, D)."""
    place = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = place < batch * size
    b, j = place // size, place % size
    row = t * batch + b
    last = inside & (row + batch >= steps * batch)
    rest = inside & (row + batch < steps * batch)
    kept = tl.load(keep + row, mask=inside, other=0.0)
    next_kept = tl.load(keep + row + batch, mask=rest, other=0.0)
    own, state = row * 4 * size + j, row * size + j
    i = tl.load(gates + own, mask=inside, other=0.0)
    f = tl.load(gates + own + size, mask=inside, other=0.0)
    g = tl.load(gates + own + 2 * size, mask=inside, other=0.0)
    o = tl.load(gates + own + 3 * size, mask=inside, other=0.0)
    y = tl.load(c_tanh + state, mask=inside, other=0.0)
    after = tl.load(d_next + b * deep + j, mask=rest, other=0.0).to(tl.float32) * next_kept
    after += tl.load(dh + place, mask=last, other=0.0)
    d = tl.load(d_hidden + state, mask=inside, other=0.0) + after
    d_cell = tl.load(dc + place, mask=inside, other=0.0) + d * o * (1 - y * y)
    before = tl.load(c_in + state, mask=inside, other=0.0)
    # A store rounds to the type of its target.
    to = row * wide + j
    tl.store(d_projected + to, d_cell * g * i * (1 - i), mask=inside)
    tl.store(d_projected + to + size, d_cell * before * f * (1 - f), mask=inside)
    tl.store(d_projected + to + 2 * size, d_cell * i * (1 - g * g), mask=inside)
    tl.store(d_projected + to + 3 * size, d * y * o * (1 - o), mask=inside)
    tl.store(dc + place, d_cell * f * kept, mask=inside)


def forward(
    projected: Tensor, weight_hh: Tensor, h: Tensor, c: Tensor, keep: Tensor
) -> tuple[Tensor, Tensor, Tensor, Saved]:
    """Run the recursion; see `MaskedLSTMFunction.forward`.

    Returns:
        Hidden states (T, B, H), last hidden and cell state (B, H), and what `backward` needs.
    """
    steps, batch, _ = projected.shape
    size = weight_hh.shape[1]
    wide, deep = padded(4 * size), padded(size)
    weight = F.pad(weight_hh, (0, deep - size, 0, wide - 4 * size)).to(projected.dtype)
    projected = projected.contiguous()
    gates = torch.empty_like(projected, dtype=torch.float32)
    h_in = projected.new_zeros(steps, batch, deep)
    c_in = gates.new_empty(steps, batch, size)
    c_tanh, hidden = torch.empty_like(c_in), torch.empty_like(c_in)
    h_in[0, :, :size] = h * keep[0]
    c, added, recurrent = c.clone(), projected.new_empty(batch, wide), weight.t()
    grid = (triton.cdiv(batch * size, BLOCK),)
    for t, h_t in enumerate(h_in.unbind()):
        torch.mm(h_t, recurrent, out=added)
        forward_kernel[grid](
            projected, added, keep, gates, c_in, c_tanh, hidden, h_in, c,
            t, steps, batch, size, wide, deep, BLOCK,
        )  # fmt: skip
    return hidden, hidden[-1].clone(), c, (gates, weight, h_in, c_in, c_tanh)


def backward(
    saved: Saved, keep: Tensor, d_hidden: Tensor, dh: Tensor, dc: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the gradients of the first four arguments of `forward`."""
    gates, weight, h_in, c_in, c_tanh = saved
    steps, batch, size = c_in.shape
    wide, deep = weight.shape
    d_projected = weight.new_zeros(steps, batch, wide)
    d_next, dc = weight.new_empty(batch, deep), dc.clone()
    d_hidden, dh = d_hidden.contiguous(), dh.contiguous()
    grid = (triton.cdiv(batch * size, BLOCK),)
    for t, low in reversed(list(enumerate(d_projected.unbind()))):
        backward_kernel[grid](
            d_next, dh, d_hidden, keep, gates, c_in, c_tanh, d_projected, dc,
            t, steps, batch, size, wide, deep, BLOCK,
        )  # fmt: skip
        torch.mm(low, weight, out=d_next)
    d_weight = d_projected.view(-1, wide).t() @ h_in.view(-1, deep)
    d_weight = d_weight[: 4 * size, :size].to(keep.dtype)
    return d_projected[:, :, : 4 * size], d_weight, d_next[:, :size] * keep[0], dc


def compile_kernels() -> None:
    """Compile the kernels for the current GPU by running them on one cell.

    Raises:
        Exception: of Triton, the C compiler or the driver.
    """
    for dtype in (torch.float32, torch.bfloat16):
        state, keep = torch.zeros(1, 1, device="cuda"), torch.ones(1, 1, 1, device="cuda")
        projected = torch.zeros(1, 1, 4, device="cuda", dtype=dtype)
        weight = torch.zeros(4, 1, device="cuda")
        *_, saved = forward(projected, weight, state, state, keep)
        backward(saved, keep, keep, state, state)
