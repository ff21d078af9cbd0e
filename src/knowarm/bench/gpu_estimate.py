"""Estimates of the bytes and operations per environment step, from the sizes of arrays.

They put a measured speed in relation to the device's peak rates. They count necessary work only:
weights, which stay in caches, and everything small are omitted. The true share of a peak rate is
therefore a little higher than the estimate.
"""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import nn

from knowarm.policy import Policy
from knowarm.world.backends.warp import import_warp, make_data
from knowarm.world.compose import SUBSTEPS
from knowarm.world.config import EnvConfig
from knowarm.world.render import Raycaster
from knowarm.world.render.intersections import BOX, CAPSULE, CYLINDER, ELLIPSOID, PLANE, SPHERE
from knowarm.world.render.tiles import BITS, EXTENT, RECORD, TILE
from knowarm.world.scene import Scene

NUMBER = 4
"""Bytes of a float32 or int32."""

NO_GEOM = -1

TEST_OPERATIONS = {PLANE: 25, SPHERE: 64, CAPSULE: 164, ELLIPSOID: 80, CYLINDER: 74, BOX: 56}
"""Operations of one ray-geom intersection, by geom type, counted in ``render/intersections.py``.

Each addition, multiplication, division, square root, comparison, minimum or selection counts as
one; 12 of them transform the ray into the geom's frame. Triangles of meshes are not counted."""


def environment_bytes(scene: Scene, config: EnvConfig) -> int:
    """Return the bytes that one environment step moves: ``P + 2 R + 2 S W``.

    P is the image, written once; R the records of the geoms in view, written and read; S the
    number of substeps, each of which reads and writes the W bytes of Warp's arrays of one world.
    """
    records = NUMBER * (RECORD + EXTENT) * scene.model.ngeom
    warp, _ = import_warp()
    with warp.ScopedDevice("cpu"):
        one, two = (world_bytes(make_data(scene.model, count)) for count in (1, 2))
    return 3 * config.image_size**2 + 2 * records + 2 * SUBSTEPS * (two - one)


def world_bytes(data: Any) -> int:
    """Return the bytes of Warp's arrays in a dataclass, without contacts and constraints (efc).

    Those are allocated for the worst case, which no step moves.
    """
    return sum(
        int(getattr(getattr(data, field.name), "capacity", 0) or 0)
        for field in dataclasses.fields(data)
        if "efc" not in field.name
    )


def training_bytes(policy: Policy, config: EnvConfig, epochs: int, item: int) -> int:
    """Return the bytes that learning from one environment step moves, without the environment's.

    ``P + (2 + E) L + 2 i (L + A) + E i (3 L + 5 A)`` for E epochs. The image (P bytes) is read and
    its patches (L bytes) are stored, then read for inference and once per epoch. Matrix products
    take the L values of the patches and the A activations as items of i bytes. Inference writes
    and reads each of them. Learning writes the patches, reads them, and reads them again for the
    gradient of the weights; the same holds for activations, whose own gradients are also written
    and read.

    Args:
        policy: the network.
        config: environment config with the size of the images.
        epochs: passes over each rollout, E.
        item: bytes per activation, i: 4, or 2 in bfloat16.
    """
    blocks, values = policy.encoder.patch_shape
    pixels, active = blocks * values, activations(policy)
    kept = 3 * config.image_size**2 + (2 + epochs) * pixels
    return kept + 2 * item * (pixels + active) + epochs * item * (3 * pixels + 5 * active)


def activations(policy: Policy) -> int:
    """Return the number of values that the network's layers compute for one image."""
    first = policy.encoder.patch_shape[0] * 4 * policy.encoder.conv1.out_channels
    # Gates, then cell, its hyperbolic tangent and the hidden state.
    memory = (4 + 3) * policy.hidden_size
    heads = policy.shape.joints * policy.shape.levels + 1
    return first + policy.encoder.width + policy.fc.out_features + memory + heads


def forward_operations(policy: Policy) -> int:
    """Return the operations of the matrix products for one image, 2 per multiplication."""
    memory = policy.memory
    inner = 4 * memory.hidden * (memory.weight_ih.shape[1] + memory.hidden)
    linear = sum(
        module.in_features * module.out_features
        for module in policy.modules()
        if isinstance(module, nn.Linear)
    )
    # The second convolution is computed as a 3 x 3 convolution over blocks of patches.
    second = policy.encoder.width * 9 * 4 * policy.encoder.conv1.out_channels
    return _first_layer(policy) + 2 * (second + inner + linear)


def training_operations(policy: Policy, epochs: int) -> int:
    """Return the operations of the matrix products per environment step, inference and learning.

    ``F + E (3 F - C)``: one forward pass for inference (F), and per epoch one forward pass and the
    gradients of weights and activations; the first layer (C) has no gradient of its input.
    """
    forward = forward_operations(policy)
    return forward + epochs * (3 * forward - _first_layer(policy))


def _first_layer(policy: Policy) -> int:
    blocks, values = policy.encoder.patch_shape
    return 2 * blocks * values * policy.encoder.conv1.out_channels


def ray_operations(
    scene: Scene,
    config: EnvConfig,
    positions: NDArray[np.float32],
    matrices: NDArray[np.float32],
    rgba: NDArray[np.float32],
) -> float:
    """Return the mean number of ray-geom intersection operations per image.

    A geom is tested for each sample of the tiles (4 x 4 samples) that its bounds overlap. Geoms
    that do not move are in a cached image and cost nothing. Skipping distant geoms and shading are
    omitted.

    Args:
        scene: the rendered scene.
        config: size and anti-aliasing of the images.
        positions: (n, G, 3) positions of the geoms in the world [m].
        matrices: (n, G, 9) rotations from geom to world.
        rgba: (n, G, 4) colours; alpha 0 hides a geom.
    """
    caster = _CountingRaycaster(
        scene.model,
        scene.camera,
        config.image_size,
        config.image_size,
        antialiasing=config.antialiasing,
    )
    counts = [caster.operations(*state) for state in zip(positions, matrices, rgba, strict=True)]
    return float(np.mean(counts))


class _CountingRaycaster(Raycaster):
    """Ray caster that counts the operations of the image it has rendered."""

    def operations(
        self,
        position: NDArray[np.float32],
        matrix: NDArray[np.float32],
        rgba: NDArray[np.float32],
    ) -> int:
        """Render one state and count; arguments as in ``Raycaster.draw``, without n."""
        extent = self._scratch[0].extent
        extent[:, 0] = NO_GEOM
        self.draw(position[None], matrix[None], rgba[None])
        return tile_operations(extent)


def tile_operations(extent: NDArray[np.int32]) -> int:
    """Return the operations of testing geoms in all tiles that they overlap.

    Args:
        extent: (G, 6) type (-1 for none), geom, first and last column and row of samples.
    """
    columns = (extent[:, 3] >> BITS) - (extent[:, 2] >> BITS) + 1
    rows = (extent[:, 5] >> BITS) - (extent[:, 4] >> BITS) + 1
    samples = columns * rows * TILE * TILE
    each = np.array([TEST_OPERATIONS.get(int(kind), 0) for kind in extent[:, 0]])
    return int((samples * each).sum())
