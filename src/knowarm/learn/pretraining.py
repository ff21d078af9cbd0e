"""Pretraining: from the first images of many episodes, learn where the target stands.

Which object a query means, and where it stands, is learned from many scenes, and a rollout shows
few: 25 steps of 128 environments show some 64 new ones. So before the first update episodes are
only started: the memory learns to predict the grasp position from their first image.
"""

import math
import time
from typing import NamedTuple

import torch
from torch import Tensor, nn

from knowarm.learn.environment import PrivilegedVectorEnv
from knowarm.learn.privileged import POSITION, privileged_columns_of
from knowarm.learn.trainer import Hooks
from knowarm.policy import Policy
from knowarm.seeding import derive_seed, torch_generator

ROUND = 4096
"""Episodes that are drawn and learned from at a time; at least one per environment."""

PASSES, BATCH, LEARNING_RATE = 4, 256, 1.5e-3
"""Passes over the images of a round, images per gradient step, largest learning rate of Adam."""


class FirstImages(NamedTuple):
    """First images of N episodes."""

    patches: Tensor
    """(N, S, L) uint8."""
    facet: Tensor
    """(N,) int64."""
    position: Tensor
    """(N, 3) float32: grasp position [m]."""


def pretrain(
    policy: Policy, env: PrivilegedVectorEnv, *, episodes: int, seed: int, hooks: Hooks
) -> bool:
    """Train the layers up to the memory; a linear head on its hidden state is dropped afterwards.

    The loss is the mean squared error of the standardized grasp position. The learning rate falls
    to a tenth along half a cosine.

    Args:
        policy: trained in place.
        env: draws the episodes; left in any state.
        episodes: how many, rounded up to a multiple of the number of environments.
        seed: of the run; episodes, order and head have streams of their own.
        hooks: told what happens; ``should_stop`` is asked between rounds.

    Returns:
        Whether it was completed.
    """
    begin, loss = time.perf_counter(), 0.0
    resets = -(-episodes // env.num_envs)
    per_round = max(1, ROUND // env.num_envs)
    hooks.on_text(f"pretraining on {resets * env.num_envs:,} episodes")
    env.reset(seed=derive_seed(seed, "pretraining"))
    generator = torch_generator(seed, "pretraining", 1, device=env.device)
    head = nn.Linear(policy.hidden_size, 3)
    nn.init.orthogonal_(head.weight, generator=torch_generator(seed, "weights", 3))
    nn.init.zeros_(head.bias)
    head.to(env.device)
    optimizer = torch.optim.Adam([*policy.parameters(), *head.parameters()], LEARNING_RATE)
    mean = deviation = torch.zeros(())
    for first in range(0, resets, per_round):
        if hooks.should_stop():
            return False
        (group,) = optimizer.param_groups
        group["lr"] = LEARNING_RATE * (0.55 + 0.45 * math.cos(math.pi * first / resets))
        images = draw_first_images(policy, env, min(per_round, resets - first))
        if first == 0:
            mean, deviation = images.position.mean(0), images.position.std(0).clamp(min=1e-6)
        standardized = images._replace(position=(images.position - mean) / deviation)
        loss = _fit(policy, head, standardized, optimizer, generator)
    hooks.on_text(
        f"pretrained for {time.perf_counter() - begin:,.0f} s: squared error {loss:.2f} of the "
        "grasp position's variance"
    )
    return True


@torch.no_grad()
def draw_first_images(policy: Policy, env: PrivilegedVectorEnv, resets: int) -> FirstImages:
    """Start the episodes of all n environments ``resets`` times, N = n * resets."""
    columns = privileged_columns_of(env)
    wanted = torch.tensor(
        [i for i, name in enumerate(columns) if name.split("/")[0] == POSITION], device=env.device
    )
    parts: list[tuple[Tensor, Tensor, Tensor]] = []
    for _ in range(resets):
        image, _ = env.reset()
        position = env.privileged_state.index_select(1, wanted)
        parts.append((policy.patches(image), env.facet_ids.clone(), position))
    return FirstImages(*(torch.cat(part) for part in zip(*parts, strict=True)))


def _fit(
    policy: Policy,
    head: nn.Linear,
    images: FirstImages,
    optimizer: torch.optim.Optimizer,
    generator: torch.Generator,
) -> float:
    """Train on the images; return the mean loss of the first pass, on images not yet seen."""
    count, device = len(images.facet), images.facet.device
    new = torch.zeros((), device=device)
    for number in range(PASSES):
        order = torch.randperm(count, generator=generator, device=device)
        for rows in order.split(BATCH):
            start = torch.ones(len(rows), dtype=torch.bool, device=device)
            state = policy.initial_state(len(rows))
            _, _, (hidden, _) = policy.step(images.patches[rows], images.facet[rows], state, start)
            loss = (head(hidden.float()) - images.position[rows]).square().mean()
            optimizer.zero_grad(set_to_none=False)
            loss.backward()
            optimizer.step()
            if number == 0:
                new += loss.detach() * len(rows)
    return float(new) / count
