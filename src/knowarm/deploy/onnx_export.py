"""ONNX export of one step of a policy, and of its grounding network."""

import logging
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from knowarm.deploy.runner import Arrays, Model
from knowarm.errors import packages_of
from knowarm.policy.policy import Policy
from knowarm.reading import replacing

INPUTS = ("image", "knowledge", "h", "c", "episode_start")
OUTPUTS = ("action", "logits", "value", "next_h", "next_c")
RECOGNITION_INPUTS = ("image", "query")
RECOGNITION_OUTPUTS = ("knowledge",)


class PolicyStep(nn.Module):
    """`Policy.step` with a flat signature, and the greedy action as first output.

    Inputs: ``image`` (B, H, W, 3) uint8, ``knowledge`` (B, K) float32, the recurrent state ``h``
    and ``c`` (B, hidden) float32 (zeros before the first step), ``episode_start`` (B,) bool.
    Outputs: ``action`` (B, J) int64, the most probable levels, ``logits`` (B, J, A), ``value``
    (B,), and the next recurrent state, ``next_h`` and ``next_c``.
    """

    def __init__(self, policy: Policy) -> None:
        super().__init__()
        self.policy = policy

    def forward(
        self,
        image: Tensor,
        knowledge: Tensor,
        h: Tensor,
        c: Tensor,
        episode_start: Tensor,
    ) -> tuple[Tensor, ...]:
        """Compute one step."""
        logits, value, (h, c) = self.policy.step(
            image, knowledge, (h, c), episode_start
        )
        return logits.argmax(-1), logits, value, h, c

    def example(self) -> tuple[Tensor, ...]:
        """Return inputs of batch size 2: a traced batch size of 1 would become a constant."""
        shape = self.policy.shape
        return (
            torch.zeros((2, shape.image_size, shape.image_size, 3), dtype=torch.uint8),
            torch.zeros(2, self.policy.knowledge_width),
            *self.policy.initial_state(2),
            torch.ones(2, dtype=torch.bool),
        )


def export_onnx(
    module: nn.Module,
    example: tuple[Tensor, ...],
    path: Path,
    *,
    about: Mapping[str, str] | None = None,
    inputs: Sequence[str] = INPUTS,
    outputs: Sequence[str] = OUTPUTS,
) -> None:
    """Write a module as ONNX (opset 18) for any batch size, with names of inputs and outputs.

    ``about`` is stored as metadata.

    Raises:
        UserError: the packages of ``pip install 'knowarm[onnx]'`` are missing.
    """
    batch = torch.export.Dim("batch", min=2)  # of the trace; ONNX plays 1 as well
    # Warns of torchvision's operators, which no model has
    log = logging.getLogger("torch.onnx")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        with packages_of("onnx", "Exporting"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # deprecations inside of torch
            program = torch.onnx.export(
                module.eval(),
                example,
                input_names=list(inputs),
                output_names=list(outputs),
                dynamic_shapes=tuple({0: batch} for _ in inputs),
                opset_version=18,
                dynamo=True,
                verbose=False,
            )
    finally:
        log.setLevel(level)
    assert program is not None
    for tensor in program.model.graph.inputs:
        sizes = tensor.shape or (0,)
        assert not isinstance(sizes[0], int), (
            f"{tensor.name} was exported for one batch size only"
        )
    for node in program.model.graph:
        node.metadata_props.clear()  # paths of this machine
    program.model.metadata_props.update(about or {})
    with replacing(path) as temporary:
        program.save(temporary)


def torch_model(module: nn.Module, names: Sequence[str]) -> Model:
    """Return a module as a model of the runner, computed by PyTorch."""

    @torch.inference_mode()
    def call(inputs: Arrays) -> list[np.ndarray]:
        arguments = [torch.from_numpy(inputs[name].copy()) for name in names]
        outputs: Any = module(*arguments)
        if not isinstance(outputs, tuple):
            outputs = (outputs,)
        return [output.numpy() for output in outputs]

    return call
