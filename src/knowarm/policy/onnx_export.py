"""ONNX export of one step of a policy."""

from pathlib import Path

import torch
from torch import Tensor, nn

from knowarm.errors import UserError
from knowarm.policy.policy import Policy

INPUTS = ("image", "knowledge", "h", "c", "episode_start")
OUTPUTS = ("action", "logits", "value", "next_h", "next_c")


class _Step(nn.Module):
    """`Policy.step_with_knowledge` with a flat signature, and the greedy action as first output."""

    def __init__(self, policy: Policy) -> None:
        super().__init__()
        self.policy = policy

    def forward(
        self, image: Tensor, knowledge: Tensor, h: Tensor, c: Tensor, episode_start: Tensor
    ) -> tuple[Tensor, ...]:
        logits, value, (h, c) = self.policy.step_with_knowledge(
            image, knowledge, (h, c), episode_start
        )
        return logits.argmax(-1), logits, value, h, c


def export_onnx(policy: Policy, path: Path) -> None:
    """Write one step of a policy as ONNX (opset 18), for any batch size B.

    Inputs: ``image`` (B, H, W, 3) uint8, ``knowledge`` (B, K) float32, the recurrent state ``h``
    and ``c`` (B, hidden) float32 (zeros before the first step), ``episode_start`` (B,) bool.
    Outputs: ``action`` (B, J) int64, the most probable levels, ``logits`` (B, J, A), ``value``
    (B,), and the next recurrent state, ``next_h`` and ``next_c``.

    Raises:
        UserError: the packages of ``pip install 'knowarm[onnx]'`` are missing.
    """
    shape = policy.shape
    batch = torch.export.Dim("batch", min=1)
    # Batch size 2: a traced batch size of 1 would be exported as a constant.
    example = (
        torch.zeros((2, shape.image_size, shape.image_size, 3), dtype=torch.uint8),
        torch.zeros(2, shape.knowledge_dim),
        *policy.initial_state(2),
        torch.ones(2, dtype=torch.bool),
    )
    try:
        program = torch.onnx.export(
            _Step(policy).eval(),
            example,
            input_names=list(INPUTS),
            output_names=list(OUTPUTS),
            dynamic_shapes=tuple({0: batch} for _ in INPUTS),
            opset_version=18,
            dynamo=True,
            verbose=False,
        )
    except ImportError as error:
        raise UserError(
            f"Exporting needs a package that is not installed ({error.name}): "
            "pip install 'knowarm[onnx]'."
        ) from error
    assert program is not None
    program.save(path)
