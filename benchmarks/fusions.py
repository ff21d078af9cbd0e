"""Fusions on a supervised choice: find the shape or colour that a vector names in an image.

Four shapes of different colours stand in the quarters of a 64 x 64 image; the knowledge vector has
a slot for the shape and one for the colour, of which one is filled with a random code. The policy's
network regresses the position of what the code names. No reinforcement learning is involved, so the
comparison takes minutes.

    python benchmarks/fusions.py --fusions before_lstm film similarity --steps 1000
"""

import argparse

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from knowarm.policy import Policy, PolicyConfig, PolicyShape
from knowarm.world.objects import COLOURS

SIDE, BATCH, POOL, SLOT = 64, 64, 8192, 50
HALF_SIZES = torch.tensor([[7, 7], [5, 5], [8, 3], [3, 8]])
"""Half height and width of each shape [px]."""


def scenes(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
    """Draw images (n, 64, 64, 3) uint8, knowledge (n, 100) and wanted positions (n, 2)."""

    def draw(size: int, take: int) -> Tensor:
        return torch.rand(count, size, generator=generator).argsort(1)[:, :take]

    palette = (torch.tensor(list(COLOURS.values())) * 255).to(torch.uint8)
    codes = torch.Generator().manual_seed(1)
    shape_codes = normalize(torch.randn(len(HALF_SIZES), SLOT, generator=codes))
    colour_codes = normalize(torch.randn(len(palette), SLOT, generator=codes))
    shape, colour = draw(4, 4), draw(len(palette), 4)
    corners = torch.tensor([[16, 16], [16, 48], [48, 16], [48, 48]])
    jitter = torch.randint(-7, 8, (count, 4, 2), generator=generator)
    centre = corners[draw(4, 4)] + jitter
    image = torch.full((count, SIDE, SIDE, 3), 90, dtype=torch.uint8)
    rows = torch.arange(SIDE)
    for j in range(4):
        half = HALF_SIZES[shape[:, j]]
        high = (rows - centre[:, j, :1]).abs() < half[:, :1]
        wide = (rows - centre[:, j, 1:]).abs() < half[:, 1:]
        inside = high[:, :, None] & wide[:, None]
        image = torch.where(inside[..., None], palette[colour[:, j]][:, None, None], image)
    asks_shape = torch.rand(count, 1, generator=generator) < 0.5
    slots = (shape_codes[shape[:, 0]] * asks_shape, colour_codes[colour[:, 0]] * ~asks_shape)
    return image, torch.cat(slots, 1), (centre[:, 0].float() - SIDE / 2) / (SIDE / 2)


def main() -> None:
    """Train a network per fusion on the same batches and print the share of images solved."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fusions", nargs="+", default=["before_lstm", "film", "similarity"])
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(arguments.seed)
    images, told, wanted = scenes(POOL, generator)
    shape = PolicyShape(joints=1, levels=2, knowledge_dim=2 * SLOT, knowledge_slots=2)
    policies, optimizers = {}, {}
    for name in arguments.fusions:
        config = PolicyConfig(fusion=name, hidden=128, pixel_shift=0.5, pixel_scale=4.0)
        policies[name] = Policy(config, shape, np.zeros((1, 2 * SLOT)), seed=arguments.seed)
        optimizers[name] = torch.optim.Adam(policies[name].parameters(), 1e-3)
    solved: dict[str, list[float]] = {name: [] for name in policies}
    start = torch.ones(BATCH, dtype=torch.bool)
    for step in range(1, arguments.steps + 1):
        rows = torch.randint(POOL, (BATCH,), generator=generator)
        for name, policy in policies.items():
            state = policy.initial_state(BATCH)
            logits, value, _ = policy.step_with_knowledge(images[rows], told[rows], state, start)
            error = (torch.stack([value, logits[:, 0, 0]], 1) - wanted[rows]).square().sum(1)
            optimizers[name].zero_grad()
            error.mean().backward()
            optimizers[name].step()
            solved[name].append((error < 0.08).float().mean().item())
        if step % 200 == 0:
            shares = {name: f"{100 * np.mean(each[-200:]):.0f} %" for name, each in solved.items()}
            print(f"steps {step - 199} to {step}, within 9 px: {shares}", flush=True)


if __name__ == "__main__":
    main()
