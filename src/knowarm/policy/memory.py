"""Features and a state go in; hidden states and the next state come out: no state is kept."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from knowarm.policy.lstm_function import MaskedLSTM

State = tuple[Tensor, Tensor]
"""Hidden state and cell, each (B, H)."""


class Memory(nn.Module):
    """A single-layer LSTM whose state is forgotten where an episode starts.

    Parameters have the names, shapes and gate order of ``torch.nn.LSTMCell``.
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
        """Advance one step.

        Args:
            x: (B, inputs).
            state: the state after the step before.
            episode_start: (B,) bool, true where ``x`` is the first of its episode.

        Returns:
            hidden state (B, H) and the next state.
        """
        keep = (~episode_start).to(x.dtype)[:, None]
        h, c = state[0] * keep, state[1] * keep
        gates = self._project(x) + F.linear(h, self.weight_hh)
        i, f, g, o = gates.to(c.dtype).chunk(4, 1)
        c = torch.sigmoid(f) * c + torch.sigmoid(i) * torch.tanh(g)
        h = torch.sigmoid(o) * torch.tanh(c)
        return h, (h, c)

    def unroll(self, x: Tensor, state: State, episode_start: Tensor) -> tuple[Tensor, State]:
        """Advance T steps; the same numbers as T calls of ``step``, with gradients faster.

        Args:
            x: (T, B, inputs).
            state: the state before the first step.
            episode_start: (T, B) bool.

        Returns:
            hidden states (T, B, H) and the state after the last step.
        """
        keep = (~episode_start).to(self.weight_hh.dtype)[:, :, None]
        hidden, h, c = MaskedLSTM.apply(self._project(x), self.weight_hh, *state, keep)
        return hidden, (h, c)

    def _project(self, x: Tensor) -> Tensor:
        return F.linear(x, self.weight_ih, self.bias_ih + self.bias_hh)
