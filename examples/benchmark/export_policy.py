"""Export a network of your own to ONNX, and benchmark it.

    pip install 'knowarm[onnx]'
    python examples/benchmark/export_policy.py
    knowarm benchmark run reach-v1 --policy my_policy.onnx --cells irb120-fixed

The network takes images (n, 64, 64, 3) uint8 and returns scores (n, J, 7) of the seven levels of
each joint. Here it is untrained; ``training`` in the metadata appears in the row.
"""

import torch
from torch import nn

JOINTS = 6


class Network(nn.Module):
    """Two convolutions and a linear layer."""

    def __init__(self):
        super().__init__()
        self.layers = nn.Sequential(
            *(nn.Conv2d(3, 16, 8, 4), nn.ReLU(), nn.Conv2d(16, 16, 4, 2), nn.ReLU()),
            *(nn.Flatten(), nn.Linear(576, JOINTS * 7)),
        )

    def forward(self, image):
        """Compute the scores."""
        return self.layers(image.permute(0, 3, 1, 2) / 255).unflatten(1, (JOINTS, 7))


torch.manual_seed(0)
program = torch.onnx.export(
    Network().eval(),
    (torch.zeros((2, 64, 64, 3), dtype=torch.uint8),),
    input_names=["image"],
    output_names=["scores"],
    dynamic_shapes=({0: torch.export.Dim("n")},),
    dynamo=True,
)
for node in program.model.graph:
    node.metadata_props.clear()  # paths of this machine
program.model.metadata_props["training"] = "none"
program.save("my_policy.onnx")
print("Wrote my_policy.onnx")
