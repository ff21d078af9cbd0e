"""Looks of a scene: visual randomization, and the appearance of each episode."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from mujoco import MjModel, mjtTextureRole
from numpy.linalg import norm
from scipy.spatial.transform import Rotation

from knowarm.arrays import Floats, Floats32, Integers
from knowarm.ranges import within
from knowarm.world.scene.scene import Scene

MAX_DISTRACTORS = 4
DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)  # A geom with this colour takes its material's
FIXED_DRAWS = 16  # Uniform draws per episode that are always made
DRAWS_PER_DISTRACTOR = 5  # Two for the position and three for the colour

# Draws of each kind
_LIGHT = slice(0, 4)
_SHIFT = slice(4, 7)
_TURN = slice(7, 10)
_SURFACE = slice(10, FIXED_DRAWS)

_CLEARANCE_M = 0.14  # Least distance of a distractor from the target [m]
_SPREAD = 1.5  # Size of the distractors' rectangle relative to the targets'


_LARGEST = {
    "light": 1.0,
    "light_angle_deg": 60.0,
    "camera_shift_m": 0.5,
    "camera_turn_deg": 30.0,
    "surface_colour": 1.0,
    "distractors": MAX_DISTRACTORS,
}
"""Largest value of each field of `VisualRandomization`; the least is 0."""


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
        for name, most in _LARGEST.items():
            within(self, 0, most, name, where="VisualRandomization.")

    @property
    def draws(self) -> int:
        """Number of uniform draws per episode; 0 when everything is off."""
        if self == VisualRandomization():
            return 0
        return FIXED_DRAWS + DRAWS_PER_DISTRACTOR * self.distractors


def _material_colours(model: MjModel) -> Floats32:
    """Return the colours of the materials, (materials, 4): with a texture, times its mean."""
    colours = model.mat_rgba.astype(np.float32)
    textures = model.mat_texid[:, int(mjtTextureRole.mjTEXROLE_RGB)]
    for material, texture in enumerate(textures):
        if texture >= 0:
            channels = model.tex_nchannel[texture]
            first = model.tex_adr[texture]
            size = channels * model.tex_width[texture] * model.tex_height[texture]
            texels = model.tex_data[first : first + size].reshape(-1, channels)
            colours[material, :3] *= texels[:, :3].mean(axis=0) / 255
    return colours


def geom_colours(model: MjModel) -> Floats32:
    """Return the colours as MuJoCo draws them, (G, 4): the geom's own, or its material's."""
    colours = model.geom_rgba.astype(np.float32)
    is_default = (model.geom_rgba == DEFAULT_RGBA).all(axis=1)
    from_material = is_default & (model.geom_matid >= 0)
    colours[from_material] = _material_colours(model)[model.geom_matid[from_material]]
    return colours


def resting_colours(scene: Scene, num_envs: int) -> Floats32:
    """Return the colours of the model files with all targets hidden, (n, G, 4) in 0..1."""
    rgba = geom_colours(scene.model)
    rgba[scene.geom_target >= 0, 3] = 0.0
    return np.repeat(rgba[None], num_envs, axis=0)


# Colours of the object to reach and of the others in a task that paints its goal
MARKED_RGB = (1.0, 0.0, 1.0)
UNMARKED_RGB = (0.72, 0.72, 0.72)


class TargetColours:
    """Colours that show some targets, each in one of its colours, and hide the others."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._resting = resting_colours(scene, 1)[0]

    def __call__(
        self,
        target: Integers,
        colour: Integers,
        marked: bool = False,
    ) -> Floats32:
        """Return the colours of every geom, new, (k, G, 4) float32 in 0..1; alpha 0 hides.

        The visible targets and their colours are indices, (k, M), or (k,) for one. ``marked``
        paints the first target in one colour and the others in another.
        """
        target = target.reshape(len(target), -1)
        colour = colour.reshape(len(target), -1)
        scene = self._scene
        rgb = self._resting[:, :3]
        alpha = self._resting[:, 3:]
        for j in range(target.shape[1]):
            visible = (scene.geom_target == target[:, j, None])[..., None]
            if marked:
                painted = visible
                paint = np.array(UNMARKED_RGB if j else MARKED_RGB, np.float32)
            else:
                painted = visible & scene.geom_coloured[:, None]
                paint = scene.target_colours[target[:, j], colour[:, j], None]
            rgb = np.where(painted, paint, rgb)
            alpha = visible + alpha
        return np.concat([rgb, alpha], axis=-1)


class Shown(NamedTuple):
    """Appearance of k environments: the arguments of ``Renderer.draw`` besides the poses."""

    rgba: Floats32  # Colours of the geoms, alpha 0 for hidden ones, (k, G, 4)
    views: Floats32 | None = None  # Cameras, (k, 12); None for the camera of the model
    lamps: Floats32 | None = None  # Lights, (k, 4, 3); None for the lights of the model
    # x and y of the distractors [m], (k, D, 2); None without randomization
    distractor_position: Floats | None = None


class AppearanceSource:
    """Computes the appearance of episodes; ``marked`` as in ``TargetColours``."""

    def __init__(
        self,
        scene: Scene,
        randomization: VisualRandomization,
        marked: bool = False,
    ) -> None:
        self._scene = scene
        self._config = randomization
        self._marked = marked
        self._colours = TargetColours(scene)

    def __call__(
        self,
        target: Integers,
        colour: Integers,
        position: Floats,
        look: Floats,
    ) -> Shown:
        """Compute the appearance of k episodes.

        Targets and colours are indices (k, M), ``position`` x and y of the first one, (k, 2) [m],
        from which distractors keep a distance, and ``look`` draws in [0, 1), (k, ``config.draws``).
        """
        config = self._config
        scene = self._scene
        rgba = self._colours(target, colour, self._marked)
        if not config.draws:
            return Shown(rgba)
        signed = 2 * look - 1
        if config.surface_colour > 0:
            rgba[:, scene.surface_geoms, :3] = self._surface_colours(signed)
        shape = (len(look), config.distractors, DRAWS_PER_DISTRACTOR)
        draws = look[:, FIXED_DRAWS:].reshape(shape)
        rgba[:, scene.distractor_geoms, :3] = draws[..., 2:]
        views = None
        if config.camera_shift_m > 0 or config.camera_turn_deg > 0:
            views = self._views(signed)
        lamps = None
        if config.light > 0 or config.light_angle_deg > 0:
            lamps = self._lamps(signed)
        return Shown(rgba, views, lamps, self._places(2 * draws[..., :2] - 1, position))

    def _views(self, signed: Floats) -> Floats32:
        scene = self._scene
        shift = self._config.camera_shift_m * signed[:, _SHIFT]
        position = scene.camera_position + shift
        turn = math.radians(self._config.camera_turn_deg) * signed[:, _TURN]
        matrix = scene.camera_matrix @ Rotation.from_rotvec(turn).as_matrix()
        return np.concat([position, matrix.reshape(-1, 9)], axis=1).astype(np.float32)

    def _lamps(self, signed: Floats) -> Floats32:
        model = self._scene.model
        headlight = model.vis.headlight
        ambient = headlight.ambient + model.light_ambient.sum(axis=0)
        head, sun, turn_x, turn_y = np.split(signed[:, _LIGHT], 4, axis=1)
        head = 1 + self._config.light * head
        sun = 1 + self._config.light * sun
        turn = np.concat([turn_x, turn_y, np.zeros_like(turn_x)], axis=1)
        turn *= math.radians(self._config.light_angle_deg)
        towards = -(Rotation.from_rotvec(turn).as_matrix() @ model.light_dir[0])
        diffuse = model.light_diffuse[0] * sun
        lamps = [ambient * head, headlight.diffuse * head, diffuse, towards]
        return np.stack(lamps, axis=1).astype(np.float32)

    def _surface_colours(self, signed: Floats) -> Floats:
        """Return RGB of the floor and, if there is one, the table top, (k, S, 3)."""
        scene = self._scene
        resting = scene.model.geom_rgba[scene.surface_geoms, :3]
        draws = signed[:, _SURFACE].reshape(-1, 2, 3)
        change = self._config.surface_colour * draws[:, : len(resting)]
        return np.clip(resting + change, 0, 1)

    def _places(self, signed: Floats, position: Floats) -> Floats:
        """Return positions in a rectangle larger than the targets', pushed away from the target."""
        robot = self._scene.robot
        position = position[:, None]
        half = _SPREAD * np.array(robot.rectangle_half_size_m)
        drawn = robot.rectangle_centre_m + signed * half
        offset = drawn - position
        distance = norm(offset, axis=-1, keepdims=True)
        pushed = position + offset / np.clip(distance, 1e-9, None) * _CLEARANCE_M
        return np.where(distance < _CLEARANCE_M, pushed, drawn)
