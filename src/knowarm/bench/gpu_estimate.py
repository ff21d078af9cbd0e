"""A network and a scene go in; the bytes and operations that one step needs come out.

Estimates from the sizes of arrays, for setting a measured speed beside the device's ceilings. They
count what has to happen, not what does: weights, which caches hold, and everything small are left
out. So the true distance from a ceiling is a little less than they say.
"""

import dataclasses
from typing import Any

from torch import nn

from knowarm.policy import Policy
from knowarm.world.compose import SUBSTEPS
from knowarm.world.config import EnvConfig
from knowarm.world.gpu.device import import_warp
from knowarm.world.gpu.simulation import make_data
from knowarm.world.render.tiles import EXTENT, RECORD
from knowarm.world.scene import Scene

NUMBER = 4
"""Bytes of a float32 or int32."""


def environment_bytes(scene: Scene, config: EnvConfig) -> int:
    """Bytes that one environment's step moves: ``P + 2 R + 2 S W``.

    P is its image, written once; R the records of its geoms before the camera, written and read;
    S the substeps, in each of which all W bytes of Warp's arrays of one world are read and written.

    Args:
        scene: what is simulated.
        config: side of the images.
    """
    records = NUMBER * (RECORD + EXTENT) * scene.model.ngeom
    warp, _ = import_warp()
    with warp.ScopedDevice("cpu"):
        one, two = (world_bytes(make_data(scene.model, count)) for count in (1, 2))
    return image_bytes(config) + 2 * records + 2 * SUBSTEPS * (two - one)


def image_bytes(config: EnvConfig) -> int:
    """Bytes of one image, (H, W, 3) uint8."""
    return 3 * config.image_size**2


def world_bytes(data: Any) -> int:
    """Bytes of Warp's arrays in a dataclass, contacts and constraints (efc) left out.

    Those have room for the worst, which no step moves.
    """
    return sum(
        int(getattr(getattr(data, field.name), "capacity", 0) or 0)
        for field in dataclasses.fields(data)
        if "efc" not in field.name
    )


def training_bytes(policy: Policy, config: EnvConfig, epochs: int, item: int) -> int:
    """Bytes that learning from one environment step moves, the environment's own left out.

    ``P + (2 + E) L + 2 i (L + A) + E i (3 L + 5 A)`` for E epochs: the image (P) is read and its
    patches (L bytes) kept, read for inference and once an epoch. Products take the patches' L
    values and A activations as items of i bytes: each is written and read when the network plays;
    when it learns, patches are written, read, and read again for the weights' gradient, and so are
    activations, whose own gradients are written and read besides.

    Args:
        policy: the network.
        config: side of the images.
        epochs: passes over each rollout.
        item: bytes of an activation; 4, or 2 in bfloat16.
    """
    blocks, values = policy.encoder.patch_shape
    pixels, active = blocks * values, activations(policy)
    kept = image_bytes(config) + (2 + epochs) * pixels
    return kept + 2 * item * (pixels + active) + epochs * item * (3 * pixels + 5 * active)


def activations(policy: Policy) -> int:
    """Numbers that the network's layers give for one image."""
    sizes = policy.config
    first = policy.encoder.patch_shape[0] * 4 * policy.encoder.conv1.out_channels
    # Gates, then cell, its hyperbolic tangent and the hidden state.
    memory = (4 + 3) * sizes.hidden_size
    heads = sizes.joints * sizes.levels + 1
    return first + policy.encoder.width + sizes.features + memory + heads


def forward_operations(policy: Policy) -> int:
    """Operations of the products that one image takes through the network, 2 a multiplication."""
    memory = policy.memory
    inner = 4 * memory.hidden * (memory.weight_ih.shape[1] + memory.hidden)
    linear = sum(
        module.in_features * module.out_features
        for module in policy.modules()
        if isinstance(module, nn.Linear)
    )
    return _first_layer(policy) + 2 * (_second_layer(policy) + inner + linear)


def training_operations(policy: Policy, epochs: int) -> int:
    """Operations of the products that one environment step takes in playing and learning.

    ``F + E (3 F - C)``: the network plays once (F) and learns E times, forward, for the weights'
    gradient and for the activations'; pixels (C, the first layer) need none.
    """
    forward = forward_operations(policy)
    return forward + epochs * (3 * forward - _first_layer(policy))


def _first_layer(policy: Policy) -> int:
    blocks, values = policy.encoder.patch_shape
    return 2 * blocks * values * policy.encoder.conv1.out_channels


def _second_layer(policy: Policy) -> int:
    """Multiplications of the second convolution, as it is done: 3 x 3 over blocks."""
    encoder = policy.encoder
    return encoder.width * 9 * 4 * encoder.conv1.out_channels
