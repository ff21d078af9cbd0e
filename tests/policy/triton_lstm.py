"""Program that compares the LSTM's Triton kernels with PyTorch's operations, without a GPU.

Triton's interpreter, which an environment variable selects before Triton is first imported, runs
them on the CPU: ``TRITON_INTERPRET=1 python -m tests.policy.triton_lstm compare``. Without it,
``compile`` compiles them for compute capability 9.0 and prints what may not occur, as JSON.
"""

import json
import re
import sys
from typing import Any

import torch
import triton
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource

from knowarm.policy import lstm, lstm_kernels, lstm_triton

T, B = 4, 3


def run(low: torch.dtype, hidden: int, inputs: int, fused: bool) -> list[torch.Tensor]:
    """Return outputs and gradients of an unroll in bfloat16 or float32."""
    lstm._uses_triton = lambda x: fused
    lstm._triton = lambda: lstm_triton
    torch.manual_seed(hidden)
    memory = lstm.MaskedLSTM(inputs, hidden)
    for parameter in memory.parameters():
        torch.nn.init.normal_(parameter)
    x = torch.randn(T, B, inputs, requires_grad=True)
    state = [torch.randn(B, hidden, requires_grad=True) for _ in range(2)]
    with torch.autocast("cpu", torch.bfloat16, enabled=low == torch.bfloat16):
        out, (h, c) = memory.unroll(x, tuple(state), torch.rand(T, B) < 0.3)
    (out.square().sum() + h.sin().sum() + c.cos().sum()).backward()
    leaves = [x, *state, *memory.parameters()]
    return [out, h, c, *(leaf.grad for leaf in leaves)]


def compare() -> None:
    # PyTorch's operations as on a GPU, not the CPU's compiled loop.
    lstm_kernels._can_compile = lambda tensor: False
    for low, tolerance in ((torch.float32, 1e-5), (torch.bfloat16, 0.05)):
        for hidden, inputs in ((8, 16), (5, 7), (90, 3)):
            got, expected = (run(low, hidden, inputs, fused) for fused in (True, False))
            for one, other in zip(got, expected, strict=True):
                error = float((one - other).abs().max() / other.abs().max())
                assert error < tolerance, (low, hidden, inputs, error)
                print(low, hidden, error)


def compile_kernels() -> None:
    found: dict[str, Any] = {}
    target = GPUTarget("cuda", 90, 32)
    numbers = dict.fromkeys(("t", "steps", "batch", "size", "wide", "deep"), "i32")
    full, low = "*fp32", "*bf16"
    pointers = {
        "forward_kernel": {"projected": low, "added": low, "h_in": low},
        "backward_kernel": {"d_next": low, "d_projected": low},
    }
    for name, exceptions in pointers.items():
        kernel = getattr(lstm_triton, name)
        types = {argument: exceptions.get(argument, full) for argument in kernel.arg_names}
        signature = types | numbers | {"BLOCK": "constexpr"}
        source = ASTSource(kernel, signature, constexprs={"BLOCK": lstm_triton.BLOCK})
        ptx = triton.compile(source, target=target).asm["ptx"]
        found[name] = {
            "f64": len(re.findall(r"\.f64", ptx)),
            "local": len(re.findall(r"\.local", ptx)),
            "stores": len(re.findall(r"st\.global", ptx)),
        }
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    {"compare": compare, "compile": compile_kernels}[sys.argv[1]]()
