"""Layouts: positions of several objects that neither overlap nor hide each other."""

import mujoco
import numpy as np

from knowarm.arrays import Floats, Integers, Mask
from knowarm.questions import object_of
from knowarm.world.scene.scene import Scene

TRIES = 16
"""Positions drawn per object, of which the first that fits is used."""

ATTEMPTS = 2
"""Layouts drawn per episode, of which the first in which all objects fit is used."""

GAP_M = 0.005
"""Least gap between two objects [m]."""

MAX_HIDDEN = 0.4
"""Largest share of an object that the others may hide from the camera, estimated by rectangles
around the objects in the image."""

_AXES = 8
"""Horizontal axes along which two objects are compared: they do not overlap if their projections
to one of them are apart."""


def draws(objects: int) -> int:
    """Return the number of draws that a layout of m objects takes."""
    return ATTEMPTS * objects * TRIES * 2


Placed = tuple[Floats, Mask]
"""Positions of m objects, (n, m, 2) [m], and whether all of them fit, (n,)."""


class LayoutSource:
    """Places m objects one after the other, each at the first position drawn that fits.

    With ``parts`` above 1 that many columns in sequence are parts of one object, at its place.
    """

    def __init__(self, scene: Scene, parts: int = 1) -> None:
        self._parts = parts
        robot = scene.robot
        self._centre = np.array(robot.rectangle_centre_m)
        self._half = np.array(robot.rectangle_half_size_m)
        angles = np.pi * np.arange(_AXES) / _AXES
        axes = np.zeros((_AXES, 3))
        axes[:, 0] = np.cos(angles)
        axes[:, 1] = np.sin(angles)
        self._axes = axes[:, :2].T
        forward = support(scene, axes)
        backward = support(scene, -axes)
        self.width: Floats = (forward + backward).max(axis=1)
        self._forward = forward + GAP_M / 2
        self._backward = backward + GAP_M / 2
        right, up, _ = scene.camera_matrix.T
        sides = np.stack([right, up])
        self._outline_low = support(scene, -sides)
        self._outline_high = support(scene, sides)
        # A point (x, y) of the support has the camera coordinates xy @ slope + offset.
        self._slope = scene.camera_matrix[:2].copy()
        height = np.array([0.0, 0.0, robot.support_height_m])
        self._offset = (height - scene.camera_position) @ scene.camera_matrix

    def __call__(self, uniforms: Floats, objects: Integers) -> Placed:
        """Place the objects (n, m) of n episodes in this order, from draws (n, ``draws(m)``).

        Return positions, (n, m, 2) [m], and whether all objects fit, (n,) bool.
        """
        objects = objects[:, :: self._parts]
        n, m = objects.shape
        drawn = uniforms.reshape(n, ATTEMPTS, m, TRIES, 2)
        position, fitting = self._attempt(drawn[:, 0], objects)
        for attempt in range(1, ATTEMPTS):
            again, fits = self._attempt(drawn[:, attempt], objects)
            position = np.where(fitting[:, None, None], position, again)
            fitting |= fits
        return np.repeat(position, self._parts, axis=1), fitting

    def _attempt(self, uniforms: Floats, objects: Integers) -> Placed:
        """Place the objects once, with draws (n, m, T, 2); returns as ``__call__``."""
        rows = np.arange(len(objects))
        fitting = np.ones(len(objects), dtype=np.bool_)
        placed: list[Floats] = []
        hidden: list[
            Floats
        ] = []  # Share of each placed object that others hide, (n, 1) each
        for j, new in enumerate(objects.T):
            signed = 2 * uniforms[:, j] - 1
            drawn = self._centre + signed * self._half
            fits = np.ones(drawn.shape[:2], dtype=np.bool_)
            shares = []
            share_of_new = np.zeros(drawn.shape[:2])
            for k, old in enumerate(objects.T[:j]):
                fits &= self._apart(drawn, new, placed[k], old)
                of_new, of_old = self._hidden(drawn, new, placed[k], old)
                share_of_new += of_new
                shares.append(hidden[k] + of_old)
            shares.append(share_of_new)
            for share in shares:
                fits &= share <= MAX_HIDDEN
            first = fits.argmax(axis=1)
            fitting &= fits[rows, first]
            placed.append(drawn[rows, first][:, None])
            hidden = [share[rows, first][:, None] for share in shares]
        return np.concatenate(placed, axis=1), fitting

    def _apart(self, a: Floats, of_a: Integers, b: Floats, of_b: Integers) -> Mask:
        """Return whether objects at a (n, T, 2) and b (n, 1, 2) do not overlap, (n, T) bool."""
        way = (b - a) @ self._axes
        ahead = self._forward[of_a] + self._backward[of_b]
        behind = self._backward[of_a] + self._forward[of_b]
        is_apart = (way > ahead[:, None]) | (-way > behind[:, None])
        return np.any(is_apart, axis=-1)

    def _hidden(
        self, a: Floats, of_a: Integers, b: Floats, of_b: Integers
    ) -> tuple[Floats, Floats]:
        """Return the share of a that b hides from the camera and the reverse, (n, T) each."""
        low_a, high_a, depth_a = self._in_image(a, of_a)
        low_b, high_b, depth_b = self._in_image(b, of_b)
        low = np.maximum(low_a, low_b)
        high = np.minimum(high_a, high_b)
        overlap = _area(np.clip(high - low, 0, None))
        share_a = overlap / _area(high_a - low_a)
        share_b = overlap / _area(high_b - low_b)
        is_nearer = depth_a < depth_b
        share_a[is_nearer] = 0.0
        share_b[~is_nearer] = 0.0
        return share_a, share_b

    def _in_image(
        self, position: Floats, objects: Integers
    ) -> tuple[Floats, Floats, Floats]:
        """Return corners (n, T, 2) of the rectangles around objects in the image, and depths."""
        camera = position @ self._slope + self._offset
        centre = camera[..., :2]
        depth = -camera[..., 2:]
        low = (centre - self._outline_low[objects][:, None]) / depth
        high = (centre + self._outline_high[objects][:, None]) / depth
        return low, high, depth[..., 0]


def _area(sides: Floats) -> Floats:
    """Return the areas of rectangles of sides (..., 2)."""
    return sides[..., 0] * sides[..., 1]


def support(scene: Scene, directions: Floats) -> Floats:
    """Return how far each target, at its yaw, extends from its origin along unit directions (D, 3).

    A part of an object extends as far as the object. The distances (K, D) [m] are exact for
    primitive shapes, and of the bounding box for meshes.
    """
    model = scene.model
    data = scene.at(scene.home)
    extent = np.full((len(scene.targets), len(directions)), -np.inf)
    for geom in np.flatnonzero(scene.geom_target >= 0).tolist():
        body = model.body_rootid[model.geom_bodyid[geom]]
        centre = data.geom_xpos[geom] - data.xpos[body]
        local = directions @ data.geom_xmat[geom].reshape(3, 3)
        along = directions @ centre + _half_width(model, geom, local)
        k = scene.geom_target[geom]
        extent[k] = np.maximum(extent[k], along)
    objects = np.array([object_of(target.name) for target in scene.targets])
    return np.stack([extent[objects == name].max(axis=0) for name in objects])


def _half_width(model: mujoco.MjModel, geom: int, local: Floats) -> Floats:
    """Return how far a geom extends from its centre along directions (D, 3) in its frame, (D,)."""
    size = model.geom_size[geom]
    kinds = mujoco.mjtGeom
    axial = np.abs(local[:, 2])
    match model.geom_type[geom]:
        case kinds.mjGEOM_SPHERE:
            return np.full(len(local), size[0])
        case kinds.mjGEOM_CAPSULE:
            return size[0] + size[1] * axial
        case kinds.mjGEOM_CYLINDER:
            radial = np.sqrt(np.maximum(0.0, 1.0 - axial**2))
            return size[0] * radial + size[1] * axial
        case kinds.mjGEOM_ELLIPSOID:
            return np.linalg.norm(size * local, axis=1)
    middle, half = model.geom_aabb[geom].reshape(2, 3)
    return local @ middle + np.abs(local) @ half
