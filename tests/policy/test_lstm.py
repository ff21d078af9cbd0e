import pytest
import torch

from knowarm.policy import lstm as lstm_module
from knowarm.policy.lstm import MaskedLSTM

T, B, N, H = 6, 3, 5, 4


@pytest.fixture
def lstm():
    torch.manual_seed(0)
    lstm = MaskedLSTM(N, H).double()
    for parameter in lstm.parameters():
        torch.nn.init.normal_(parameter)
    return lstm


def random_case():
    torch.manual_seed(1)
    x = torch.randn(T, B, N, dtype=torch.float64)
    state = (
        torch.randn(B, H, dtype=torch.float64),
        torch.randn(B, H, dtype=torch.float64),
    )
    return x, state, torch.rand(T, B) < 0.3


def test_without_masks_it_is_pytorchs_lstm(lstm):
    x, (h, c), _ = random_case()
    reference = torch.nn.LSTM(N, H).double()
    reference.load_state_dict({f"{k}_l0": v for k, v in lstm.state_dict().items()})
    expected, (last_h, last_c) = reference(x, (h[None], c[None]))
    hidden, state = lstm(x, (h, c), torch.zeros(T, B, dtype=torch.bool))
    torch.testing.assert_close(hidden, expected)
    torch.testing.assert_close(state, (last_h[0], last_c[0]))


def test_an_unroll_is_so_many_steps(lstm):
    x, state, start = random_case()
    hidden, last = lstm(x, state, start)
    for t in range(T):
        one, state = lstm.step(x[t], state, start[t])
        torch.testing.assert_close(one, hidden[t])
    torch.testing.assert_close(state, last)


def test_an_episode_start_forgets_everything_before(lstm):
    x, state, _ = random_case()
    start = torch.zeros(T, B, dtype=torch.bool)
    start[3] = True
    x.requires_grad_()
    hidden, _ = lstm(x, state, start)
    fresh, _ = lstm(x[3:], lstm.initial_state(B), start[3:])
    torch.testing.assert_close(hidden[3:], fresh)
    (gradient,) = torch.autograd.grad(hidden[3:].sum(), x)
    assert (gradient[:3] == 0).all()
    assert (gradient[3:] != 0).any()


def unrolled(x, state, start, parameters, low):
    """Return hidden states, last cell state and the gradients of a function of both."""
    lstm = MaskedLSTM(N, H)
    lstm.load_state_dict(parameters)
    x = x.clone().requires_grad_()
    state = tuple(part.clone().requires_grad_() for part in state)
    with torch.autocast("cpu", torch.bfloat16, enabled=low == torch.bfloat16):
        hidden, (h, c) = lstm(x, state, start)
    assert hidden.dtype == c.dtype == torch.float32
    loss = hidden.square().sum() + h.sin().sum() + c.cos().sum()
    return [hidden, h, c, *torch.autograd.grad(loss, [x, *state, *lstm.parameters()])]


@pytest.mark.parametrize("low", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize("scale", [1, 100])  # 100: beyond where exp overflows
@pytest.mark.parametrize("starts", ["some", "all"])
def test_the_compiled_loops_and_their_gradients_are_those_of_the_steps(
    monkeypatch, low, scale, starts
):
    x, state, start = random_case()
    start = start | (starts == "all")
    x, state = scale * x.float(), tuple(part.float() for part in state)
    lstm = MaskedLSTM(N, H)
    for parameter in lstm.parameters():
        torch.nn.init.normal_(parameter)
    compiled = unrolled(x, state, start, lstm.state_dict(), low)
    monkeypatch.setattr(lstm_module, "_has_kernels", lambda weight: False)
    steps = unrolled(x, state, start, lstm.state_dict(), low)
    tolerance = 1e-5 if low == torch.float32 else 0.05
    for i, (one, other) in enumerate(zip(compiled, steps, strict=True)):
        # Where every step is a first one, states and recurrent weights have no influence.
        largest = float(other.detach().abs().max())
        assert (largest > 0) == (starts == "some" or i not in (4, 5, 7))
        torch.testing.assert_close(
            one, other, rtol=tolerance, atol=tolerance * max(1.0, largest)
        )
