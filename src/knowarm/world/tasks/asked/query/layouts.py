"""Layouts: positions of several objects that neither overlap nor hide each other."""

import numpy as np
from mujoco import MjModel, mjtGeom
from numpy.linalg import norm

from knowarm.arrays import Floats, Integers, Mask
from knowarm.questions import object_of
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.state import Placed

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
        x = np.cos(angles)
        y = np.sin(angles)
        axes = np.column_stack([x, y, np.zeros(_AXES)])
        directions = np.concatenate([axes, -axes])
        self._directions = directions[:, :2].T
        reach = support(scene, directions)
        opposite = np.roll(reach, _AXES, axis=1)
        self.width: Floats = (reach + opposite).max(axis=1)
        self._reach = reach + GAP_M / 2
        self._opposite = opposite + GAP_M / 2
        sides = scene.camera_matrix.T[:2]  # right and up
        self._outline_low = support(scene, -sides)
        self._outline_high = support(scene, sides)
        # A point (x, y) of the support has the camera coordinates xy @ slope + offset.
        self._slope = scene.camera_matrix[:2]
        height = np.array([0.0, 0.0, robot.support_height_m])
        self._offset = (height - scene.camera_position) @ scene.camera_matrix

    def __call__(self, uniforms: Floats, objects: Integers) -> Placed:
        """Place the objects (n, m) of n episodes in this order, from draws (n, ``draws(m)``).

        Return positions, (n, m, 2) [m], and whether all objects fit, (n,) bool.
        """
        objects = objects[:, :: self._parts]
        n, m = objects.shape
        drawn = uniforms.reshape(n, ATTEMPTS, m, TRIES, 2)
        position = np.zeros((n, m, 2))
        fitting = np.zeros(n, bool)
        for attempt in range(ATTEMPTS):
            new_position, new_fitting = self._attempt(drawn[:, attempt], objects)
            position = np.where(fitting[:, None, None], position, new_position)
            fitting |= new_fitting
        return np.repeat(position, self._parts, axis=1), fitting

    def _attempt(self, uniforms: Floats, objects: Integers) -> Placed:
        """Place the objects once, with draws (n, m, T, 2); returns as ``__call__``."""
        n, m = objects.shape
        rows = np.arange(n)
        signed = 2 * uniforms - 1
        candidates = self._centre + signed * self._half
        indices = objects[..., None]
        fitting = np.ones(n, bool)
        placed = np.zeros((n, m, 1, 2))
        hidden = np.zeros((n, 0, 1))  # Share of each placed object that others hide
        for j in range(m):
            # T candidates beside each of j placed objects: arrays (n, j, T, ...)
            new = slice(j, j + 1)
            pairs = (
                candidates[:, new],
                indices[:, new],
                placed[:, :j],
                indices[:, :j],
            )
            # Shares are added as if no two objects hid the same part of a third one.
            hidden_of_new, hidden_of_placed = self._hidden(*pairs)
            total_of_new = hidden_of_new.sum(axis=1, keepdims=True)
            totals = np.concatenate([hidden + hidden_of_placed, total_of_new], axis=1)
            fits = np.all(totals <= MAX_HIDDEN, axis=1)
            fits &= np.all(self._apart(*pairs), axis=1)
            # The first that fits; where none does, the first of all, and the layout fails.
            first = fits.argmax(axis=1)
            fitting &= fits[rows, first]
            hidden = totals[rows, :, first][..., None]
            placed[:, j, 0] = candidates[rows, j, first]
        return placed[:, :, 0], fitting

    def _apart(self, a: Floats, of_a: Integers, b: Floats, of_b: Integers) -> Mask:
        """Return which objects at a and b, (..., 2) [m], do not overlap, (...) bool."""
        distance = (b - a) @ self._directions
        least = self._reach[of_a] + self._opposite[of_b]
        return np.any(distance > least, axis=-1)

    def _hidden(
        self, a: Floats, of_a: Integers, b: Floats, of_b: Integers
    ) -> tuple[Floats, Floats]:
        """Return the share of a that b hides from the camera and the reverse, (...) each."""
        low_a, high_a, depth_a = self._in_image(a, of_a)
        low_b, high_b, depth_b = self._in_image(b, of_b)
        low = np.maximum(low_a, low_b)
        high = np.minimum(high_a, high_b)
        sides = high - low
        overlap = _area(sides.clip(min=0))
        share_a = overlap / _area(high_a - low_a)
        share_b = overlap / _area(high_b - low_b)
        # Only the farther of the two is hidden.
        is_nearer = depth_a < depth_b
        share_a[is_nearer] = 0.0
        share_b[~is_nearer] = 0.0
        return share_a, share_b

    def _in_image(self, position: Floats, objects: Integers) -> tuple[Floats, ...]:
        """Return corners (..., 2) of the rectangles around objects in the image, and depths."""
        in_camera = position @ self._slope
        in_camera += self._offset
        centre = in_camera[..., :2]
        depth = -in_camera[..., 2:]
        low = (centre - self._outline_low[objects]) / depth
        high = (centre + self._outline_high[objects]) / depth
        return low, high, depth[..., 0]


def _area(sides: Floats) -> Floats:
    """Return the areas of rectangles of sides (..., 2)."""
    width, height = np.moveaxis(sides, -1, 0)
    return width * height


def support(scene: Scene, directions: Floats) -> Floats:
    """Return how far each target, at its yaw, extends from its origin along unit directions (D, 3).

    A part of an object extends as far as the object. The distances (K, D) [m] are exact for
    primitive shapes, and of the bounding box for meshes.
    """
    model = scene.model
    data = scene.at(scene.home)
    # Parts of one object share a number.
    names = [object_of(target.name) for target in scene.targets]
    _, number = np.unique(names, return_inverse=True)
    extent = np.full((len(names), len(directions)), -np.inf)
    for geom in np.flatnonzero(scene.geom_target >= 0).tolist():
        body = model.body_rootid[model.geom_bodyid[geom]]
        centre = data.geom_xpos[geom] - data.xpos[body]
        local = directions @ data.geom_xmat[geom].reshape(3, 3)
        farthest = directions @ centre
        farthest += _half_width(model, geom, local)
        k = number[scene.geom_target[geom]]
        extent[k] = np.maximum(extent[k], farthest)
    return extent[number]


def _half_width(model: MjModel, geom: int, local: Floats) -> Floats:
    """Return how far a geom extends from its centre along directions (D, 3) in its frame, (D,)."""
    size = model.geom_size[geom]
    radius, half_length, _ = size
    axial = np.abs(local[:, 2])
    match model.geom_type[geom]:
        case mjtGeom.mjGEOM_SPHERE | mjtGeom.mjGEOM_CAPSULE:  # a sphere has no length
            return radius + half_length * axial
        case mjtGeom.mjGEOM_CYLINDER:
            radial = np.sqrt(np.maximum(0.0, 1.0 - axial**2))
            return radius * radial + half_length * axial
        case mjtGeom.mjGEOM_ELLIPSOID:
            return norm(size * local, axis=1)
    middle, half = model.geom_aabb[geom].reshape(2, 3)
    return local @ middle + np.abs(local) @ half
