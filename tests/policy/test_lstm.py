import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from knowarm.policy import lstm as lstm_module
from knowarm.policy import lstm_kernels
from knowarm.policy.lstm import MaskedLSTM, MaskedLSTMFunction

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
    state = (torch.randn(B, H, dtype=torch.float64), torch.randn(B, H, dtype=torch.float64))
    return x, state, torch.rand(T, B) < 0.3


def test_without_masks_it_is_pytorchs_lstm(lstm):
    x, (h, c), _ = random_case()
    reference = torch.nn.LSTM(N, H).double()
    reference.load_state_dict({f"{k}_l0": v for k, v in lstm.state_dict().items()})
    expected, (last_h, last_c) = reference(x, (h[None], c[None]))
    hidden, state = lstm.unroll(x, (h, c), torch.zeros(T, B, dtype=torch.bool))
    torch.testing.assert_close(hidden, expected)
    torch.testing.assert_close(state, (last_h[0], last_c[0]))


def test_an_unroll_is_so_many_steps(lstm):
    x, state, start = random_case()
    hidden, last = lstm.unroll(x, state, start)
    for t in range(T):
        one, state = lstm.step(x[t], state, start[t])
        torch.testing.assert_close(one, hidden[t])
    torch.testing.assert_close(state, last)


def test_an_episode_start_forgets_everything_before(lstm):
    x, state, _ = random_case()
    start = torch.zeros(T, B, dtype=torch.bool)
    start[3] = True
    x.requires_grad_()
    hidden, _ = lstm.unroll(x, state, start)
    fresh, _ = lstm.unroll(x[3:], lstm.initial_state(B), start[3:])
    torch.testing.assert_close(hidden[3:], fresh)
    (gradient,) = torch.autograd.grad(hidden[3:].sum(), x)
    assert (gradient[:3] == 0).all()
    assert (gradient[3:] != 0).any()


def test_gradients_agree_with_finite_differences():
    torch.manual_seed(2)
    keep = (torch.rand(T, B, 1) > 0.3).double()

    def draw(*shape):
        return torch.randn(*shape, dtype=torch.float64, requires_grad=True)

    inputs = (draw(T, B, 4 * H), draw(4 * H, H), draw(B, H), draw(B, H))
    assert torch.autograd.gradcheck(lambda *a: MaskedLSTMFunction.apply(*a, keep), inputs)


def test_the_compiled_loops_do_what_the_operations_do(monkeypatch):
    results = []
    for compiled in (True, False):
        monkeypatch.setattr(lstm_kernels, "_can_compile", lambda tensor, answer=compiled: answer)
        torch.manual_seed(3)
        keep = (torch.rand(T, B, 1) > 0.3).float()
        shapes = ((T, B, 4 * H), (4 * H, H), (B, H), (B, H))
        inputs = [3 * torch.randn(shape) for shape in shapes]
        inputs[0][0, 0, :] = torch.linspace(-200, 200, 4 * H)  # beyond where exp overflows
        for tensor in inputs:
            tensor.requires_grad_()
        hidden, h, c = MaskedLSTMFunction.apply(*inputs, keep)
        (hidden.square().sum() + h.sin().sum() + c.cos().sum()).backward()
        results.append([hidden, h, c, *(tensor.grad for tensor in inputs)])
    for one, other in zip(*results, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=2e-6)


@pytest.mark.parametrize("low", [torch.float32, torch.bfloat16])
def test_the_operations_of_a_gpu_do_what_steps_do_in_both_precisions(monkeypatch, low):
    monkeypatch.setattr(lstm_kernels, "_can_compile", lambda tensor: False)
    torch.manual_seed(4)
    lstm = MaskedLSTM(N, H)
    for parameter in lstm.parameters():
        torch.nn.init.normal_(parameter)
    x, state, start = random_case()
    x, state = x.float().requires_grad_(), tuple(part.float() for part in state)
    gradients = []
    for unrolled in (True, False):
        with torch.autocast("cpu", torch.bfloat16, enabled=low == torch.bfloat16):
            if unrolled:
                hidden, (_, c) = lstm.unroll(x, state, start)
            else:
                after, steps = state, []
                for t in range(T):
                    one, after = lstm.step(x[t], after, start[t])
                    steps.append(one)
                hidden, c = torch.stack(steps), after[1]
        assert hidden.dtype == c.dtype == torch.float32
        inputs = [x, *lstm.parameters()]
        loss = hidden.square().sum() + c.sin().sum()
        gradients.append([hidden, c, *torch.autograd.grad(loss, inputs)])
    tolerance = 1e-5 if low == torch.float32 else 0.05
    for one, other in zip(*gradients, strict=True):
        torch.testing.assert_close(
            one, other, rtol=tolerance, atol=tolerance * float(other.abs().max())
        )


def triton_program(task, interpret):
    pytest.importorskip("triton")
    done = subprocess.run(
        [sys.executable, "-m", "tests.policy.triton_lstm", task],
        cwd=Path(__file__).parents[2],
        env=os.environ | {"TRITON_INTERPRET": str(int(interpret))},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_tritons_kernels_do_what_the_operations_do():
    """In Triton's interpreter, with and without padding, in float32 and bfloat16."""
    assert triton_program("compare", interpret=True)


def test_tritons_kernels_compile_for_the_gpu():
    kernels = json.loads(triton_program("compile", interpret=False))
    assert set(kernels) == {"forward_kernel", "backward_kernel"}
    for found in kernels.values():
        assert found["f64"] == found["local"] == 0
        assert found["stores"]


def test_a_triton_that_cannot_compile_is_reported_once(monkeypatch):
    pytest.importorskip("triton")
    monkeypatch.setattr(lstm_module, "_triton", lstm_module._triton.__wrapped__)
    with pytest.warns(RuntimeWarning, match="Triton could not compile the LSTM's kernels"):
        assert lstm_module._triton() is None
