"""Uniform draws of an episode go in; its light, camera, surface colours and distractors come out.

It changes pictures only, never what a robot can reach.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knowarm.world.scene import Scene
from knowarm.world.visual_randomization import (
    DRAWS_PER_DISTRACTOR,
    FIXED_DRAWS,
    VisualRandomization,
)

_CLEARANCE_M = 0.14
_SPREAD = 1.5
_LIGHT, _SHIFT, _TURN, _SURFACE = 0, 4, 7, 10


class Look(NamedTuple):
    """How k environments look; None where the model's own value serves."""

    views: NDArray[np.float32] | None
    """Position [m] and row-major rotation of the camera, world, (k, 12)."""

    lamps: NDArray[np.float32] | None
    """Sum of ambient colours; headlight's and sun's diffuse colours; direction towards the sun,
    (k, 4, 3)."""

    surface_rgb: NDArray[np.float32] | None
    """Colours of floor and, where there is one, table top, (k, S, 3)."""

    distractor_position: NDArray[np.float64]
    """Where distractors stand, x and y [m], (k, D, 2)."""

    distractor_rgb: NDArray[np.float32]
    """Colours of the distractors, (k, D, 3)."""


def looks(
    scene: Scene,
    config: VisualRandomization,
    uniforms: NDArray[np.float64],
    position: NDArray[np.float64],
) -> Look:
    """Turn draws into the looks of k episodes.

    Args:
        scene: whose camera, lights and colours vary.
        config: by how much.
        uniforms: draws in [0, 1), (k, ``config.draws``).
        position: where the targets stand, x and y [m], (k, 2); distractors keep away from it.
    """
    signed = 2 * uniforms - 1
    moved = config.camera_shift_m > 0 or config.camera_turn_deg > 0
    lit = config.light > 0 or config.light_angle_deg > 0
    rest = uniforms[:, FIXED_DRAWS:].reshape(
        len(uniforms), config.distractors, DRAWS_PER_DISTRACTOR
    )
    return Look(
        views=_views(scene, config, signed) if moved else None,
        lamps=_lamps(scene, config, signed) if lit else None,
        surface_rgb=_surfaces(scene, config, signed) if config.surface_colour > 0 else None,
        distractor_position=_places(scene, 2 * rest[..., :2] - 1, position),
        distractor_rgb=rest[..., 2:].astype(np.float32),
    )


def _views(
    scene: Scene, config: VisualRandomization, signed: NDArray[np.float64]
) -> NDArray[np.float32]:
    shift = config.camera_shift_m * signed[:, _SHIFT:_TURN]
    turn = np.radians(config.camera_turn_deg) * signed[:, _TURN:_SURFACE]
    turned = scene.camera_matrix @ rotations(turn)
    return np.concatenate([scene.camera_position + shift, turned.reshape(-1, 9)], axis=1).astype(
        np.float32
    )


def _lamps(
    scene: Scene, config: VisualRandomization, signed: NDArray[np.float64]
) -> NDArray[np.float32]:
    model = scene.model
    lamps = np.zeros((len(signed), 4, 3))
    lamps[:, 0] = np.array(model.vis.headlight.ambient) + model.light_ambient.sum(axis=0)
    lamps[:, 1] = model.vis.headlight.diffuse
    lamps[:, 2] = model.light_diffuse[0]
    lamps[:, :2] *= 1 + config.light * signed[:, None, _LIGHT : _LIGHT + 1]
    lamps[:, 2] *= 1 + config.light * signed[:, _LIGHT + 1 : _LIGHT + 2]
    turn = np.zeros((len(signed), 3))
    turn[:, :2] = np.radians(config.light_angle_deg) * signed[:, _LIGHT + 2 : _LIGHT + 4]
    lamps[:, 3] = -(rotations(turn) @ model.light_dir[0])
    return lamps.astype(np.float32)


def _surfaces(
    scene: Scene, config: VisualRandomization, signed: NDArray[np.float64]
) -> NDArray[np.float32]:
    own = scene.model.geom_rgba[list(scene.surface_geoms), :3]
    change = config.surface_colour * signed[:, _SURFACE:FIXED_DRAWS].reshape(-1, 2, 3)
    return np.clip(own + change[:, : len(own)], 0, 1).astype(np.float32)


def _places(
    scene: Scene, signed: NDArray[np.float64], position: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Places in a rectangle wider than the targets', pushed away from the target itself."""
    centre = np.array(scene.robot.rectangle_centre_m)
    half = _SPREAD * np.array(scene.robot.rectangle_half_size_m)
    place = centre + signed * half
    way = place - position[:, None, :]
    distance = np.linalg.norm(way, axis=-1, keepdims=True)
    pushed = position[:, None, :] + way / np.maximum(distance, 1e-9) * _CLEARANCE_M
    return np.where(distance < _CLEARANCE_M, pushed, place)


def rotations(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrices (k, 3, 3) of rotation vectors (k, 3) [rad], by Rodrigues' formula."""
    angle = np.linalg.norm(vectors, axis=1)
    axis = vectors / np.maximum(angle, 1e-12)[:, None]
    cross = np.zeros((len(vectors), 3, 3))
    cross[:, [2, 0, 1], [1, 2, 0]] = axis
    cross[:, [1, 2, 0], [2, 0, 1]] = -axis
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + (1 - cosine) * (cross @ cross))
