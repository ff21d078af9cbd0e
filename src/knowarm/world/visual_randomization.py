"""Visual randomization: light, camera, surface colours and distractors that vary per episode."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.arrays import Array, Place, array_namespace, here

if TYPE_CHECKING:  # The config is read where nothing else of MuJoCo is needed.
    from knowarm.world.scene import Scene

MAX_DISTRACTORS = 4
FIXED_DRAWS, DRAWS_PER_DISTRACTOR = 16, 5
"""Uniform draws per episode: those always made, and two for the position and three for the colour
of each distractor."""

_LIGHT, _SHIFT, _TURN, _SURFACE = 0, 4, 7, 10
"""Index of the first draw of each kind."""

_CLEARANCE_M = 0.14
"""Least distance of a distractor from the target [m]."""

_SPREAD = 1.5
"""Size of the distractors' rectangle relative to the targets'."""


@dataclass(frozen=True, kw_only=True)
class VisualRandomization:
    """Ranges of what varies between episodes besides the paper's colours; all off by default.

    It changes images only, never what the robot can reach.
    """

    light: float = 0.0
    """Relative change of the brightness of headlight and directional light, 0 to 1."""

    light_angle_deg: float = 0.0
    """Rotation of the directional light about x and about y, 0 to 60 [deg]."""

    camera_shift_m: float = 0.0
    """Shift of the camera along each axis, 0 to .5 [m]."""

    camera_turn_deg: float = 0.0
    """Rotation of the camera about each of its axes, 0 to 30 [deg]."""

    surface_colour: float = 0.0
    """Change of red, green and blue of floor and table, 0 to 1."""

    distractors: int = 0
    """Number of objects of other shapes and random colours beside the target, 0 to 4."""

    def __post_init__(self) -> None:
        for name, most in (
            ("light", 1.0),
            ("light_angle_deg", 60.0),
            ("camera_shift_m", 0.5),
            ("camera_turn_deg", 30.0),
            ("surface_colour", 1.0),
            ("distractors", MAX_DISTRACTORS),
        ):
            value = getattr(self, name)
            if not 0 <= value <= most:
                raise UserError(
                    f"VisualRandomization.{name} must lie in 0 to {most:g}, got {value}."
                )

    @property
    def draws(self) -> int:
        """Number of uniform draws per episode; 0 when everything is off."""
        off = self == VisualRandomization()
        return 0 if off else FIXED_DRAWS + DRAWS_PER_DISTRACTOR * self.distractors


class Look(NamedTuple):
    """Appearance of k environments; None where the model's own value applies."""

    views: NDArray[np.float32] | None
    """Position [m] and row-major rotation of the camera, world, (k, 12)."""

    lamps: NDArray[np.float32] | None
    """Sum of ambient colours, diffuse colours of headlight and directional light, and the unit
    vector towards the latter, (k, 4, 3)."""

    surface_rgb: NDArray[np.float32] | None
    """RGB of the floor and, if there is one, the table top, (k, S, 3)."""

    distractor_position: NDArray[np.float64]
    """x and y of the distractors [m], (k, D, 2)."""

    distractor_rgb: NDArray[np.float32]
    """RGB of the distractors, (k, D, 3)."""


class LookSource:
    """Computes the looks of episodes from uniform draws.

    Args:
        scene: its camera, lights and colours vary.
        config: ranges of the variation.
        place: converts the constants to arrays of the library and device used; NumPy by default.
    """

    def __init__(self, scene: "Scene", config: VisualRandomization, place: Place = here) -> None:
        model, robot = scene.model, scene.robot
        self._config = config
        self._camera_position = place(scene.camera_position)
        self._camera_matrix = place(scene.camera_matrix)
        self._ambient = place(
            np.array(model.vis.headlight.ambient) + model.light_ambient.sum(axis=0)
        )
        self._headlight = place(np.array(model.vis.headlight.diffuse, dtype=np.float64))
        self._sunlight = place(model.light_diffuse[0].astype(np.float64))
        self._sun_direction = place(model.light_dir[0].astype(np.float64))
        self._surface_rgb = place(model.geom_rgba[list(scene.surface_geoms), :3])
        self._centre = place(np.array(robot.rectangle_centre_m))
        self._half = place(_SPREAD * np.array(robot.rectangle_half_size_m))

    def __call__(self, uniforms: Array, position: Array) -> Look:
        """Compute the looks of k episodes.

        Args:
            uniforms: draws in [0, 1), (k, ``config.draws``) float64, NumPy or torch.
            position: x and y of the targets [m], (k, 2); distractors keep a distance from them.
        """
        config, xp = self._config, array_namespace(uniforms)
        signed = 2 * uniforms - 1
        moved = config.camera_shift_m > 0 or config.camera_turn_deg > 0
        lit = config.light > 0 or config.light_angle_deg > 0
        rest = xp.reshape(
            uniforms[:, FIXED_DRAWS:],
            (uniforms.shape[0], config.distractors, DRAWS_PER_DISTRACTOR),
        )
        return Look(
            views=self._views(signed) if moved else None,
            lamps=self._lamps(signed) if lit else None,
            surface_rgb=self._surfaces(signed) if config.surface_colour > 0 else None,
            distractor_position=self._places(2 * rest[..., :2] - 1, position),
            distractor_rgb=xp.astype(rest[..., 2:], xp.float32),
        )

    def _views(self, signed: Array) -> Array:
        xp = array_namespace(signed)
        shift = self._config.camera_shift_m * signed[:, _SHIFT:_TURN]
        turn = math.radians(self._config.camera_turn_deg) * signed[:, _TURN:_SURFACE]
        turned = xp.reshape(self._camera_matrix @ rotations(turn), (-1, 9))
        views = xp.concat([self._camera_position + shift, turned], axis=1)
        return xp.astype(views, xp.float32)

    def _lamps(self, signed: Array) -> Array:
        xp = array_namespace(signed)
        head = 1 + self._config.light * signed[:, _LIGHT : _LIGHT + 1]
        sun = 1 + self._config.light * signed[:, _LIGHT + 1 : _LIGHT + 2]
        turn = math.radians(self._config.light_angle_deg) * signed[:, _LIGHT + 2 : _LIGHT + 4]
        turn = xp.concat([turn, xp.zeros_like(turn[:, :1])], axis=1)
        towards = -(rotations(turn) @ self._sun_direction)
        lamps = [self._ambient * head, self._headlight * head, self._sunlight * sun, towards]
        return xp.astype(xp.stack(lamps, axis=1), xp.float32)

    def _surfaces(self, signed: Array) -> Array:
        xp = array_namespace(signed)
        draws = xp.reshape(signed[:, _SURFACE:FIXED_DRAWS], (-1, 2, 3))
        change = self._config.surface_colour * draws[:, : self._surface_rgb.shape[0]]
        return xp.astype(xp.clip(self._surface_rgb + change, 0, 1), xp.float32)

    def _places(self, signed: Array, position: Array) -> Array:
        """Return positions in a rectangle larger than the targets', pushed away from the target."""
        xp = array_namespace(signed)
        drawn = self._centre + signed * self._half
        offset = drawn - position[:, None, :]
        distance = xp.linalg.vector_norm(offset, axis=-1, keepdims=True)
        pushed = position[:, None, :] + offset / xp.clip(distance, 1e-9, None) * _CLEARANCE_M
        return xp.where(distance < _CLEARANCE_M, pushed, drawn)


def rotations(vectors: Array) -> Array:
    """Convert rotation vectors (k, 3) [rad] to matrices (k, 3, 3) by Rodrigues' formula."""
    xp = array_namespace(vectors)
    angle = xp.linalg.vector_norm(vectors, axis=1)
    axis = vectors / xp.clip(angle, 1e-12, None)[:, None]
    x, y, z = axis[:, 0], axis[:, 1], axis[:, 2]
    zero = xp.zeros_like(x)
    cross = xp.reshape(xp.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1), (-1, 3, 3))
    one = xp.eye(3, dtype=vectors.dtype, device=vectors.device)
    sine, cosine = xp.sin(angle)[:, None, None], xp.cos(angle)[:, None, None]
    return one + sine * cross + (1 - cosine) * (cross @ cross)
