"""Camera fitted to points of a photograph, with intervals by bootstrap."""

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from knowarm.arrays import Floats
from knowarm.errors import packages_of
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.compose import level_axes, roll

TO_OPENCV = np.array([1.0, -1.0, -1.0])
"""Signs of the axes from x right, y up, z backward to OpenCV's x right, y down, z forward."""

LEAST_POINTS = 4
POSE = 6
"""Numbers of a pose; the seventh that is fitted is the field of view, the eighth the lens (k1)."""

FOVY = 7
LENS = 8
FOR_FOVY = 6  # Points from which the field of view is fitted, too
FOR_LENS = 9  # Points from which barrel and pincushion distortion is
CLICK = 1 / 480
"""Least standard error of a click that intervals assume [image heights]."""

NUMBERS = {
    "x": "m",
    "y": "m",
    "z": "m",
    "roll": "degrees",
    "field of view": "degrees",
    "distortion k1": "",
}
"""Units of what is reported of a camera, by name."""


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A camera in the frame of the robot's base, whose images are seen in image heights."""

    position: Floats  # World [m], (3,)
    axes: Floats  # Right, up and backward as columns, (3, 3)
    focus: (
        Floats  # Focal lengths along x and y, principal point from the upper left, (4,)
    )
    lens: Floats  # k1, k2, p1, p2, k3, (5,)

    @property
    def matrix(self) -> Floats:
        """OpenCV's camera matrix, (3, 3)."""
        x, y, centre_x, centre_y = self.focus
        return np.array([[x, 0, centre_x], [0, y, centre_y], [0, 0, 1]])

    def see(self, places: Floats) -> Floats:
        """Project places (n, 3) [m] into the image, (n, 2): right and down from the corner."""
        local = (places - self.position) @ self.axes * TO_OPENCV
        pose = np.zeros((2, 3))
        points, _ = _cv2().projectPoints(local, *pose, self.matrix, self.lens)
        return points[:, 0]

    def fovy_deg(self, side: float = 1.0) -> float:
        """Return the field of view of a square in the image's middle, by default its height."""
        return float(np.degrees(2 * np.arctan(side / 2 / self.focus[1])))

    @property
    def roll_deg(self) -> float:
        """The turn about the optical axis from level, right side down."""
        level = level_axes(self.axes[:, 2])
        right = level.T @ self.axes[:, 0]
        return float(np.degrees(np.arctan2(-right[1], right[0])))

    @property
    def numbers(self) -> Floats:
        """The numbers that are reported, (6,), each with a name and unit of `NUMBERS`."""
        return np.array([*self.position, self.roll_deg, self.fovy_deg(), self.lens[0]])


def camera_of(robot: Robot, aspect: float = 1.0) -> Camera:
    """Return the camera of a description; ``aspect`` is the width of its images over the height."""
    position = np.array(robot.camera_position_m)
    backward = position - np.array(robot.camera_look_at_m)
    focus = robot.camera_intrinsics
    if focus is None:
        side = min(1.0, aspect)  # of the central square, which the policy sees
        length = side / 2 / np.tan(np.radians(robot.camera_fovy_deg) / 2)
        focus = (length, length, aspect / 2, 0.5)
    return Camera(
        position=position,
        axes=roll(level_axes(backward), robot.camera_roll_deg),
        focus=np.array(focus),
        lens=np.array(robot.camera_distortion or np.zeros(5)),
    )


def most_free(count: int, robot: Robot) -> int:
    """Return how many numbers of a camera are fitted to a count of points."""
    if robot.camera_intrinsics is not None or count < FOR_FOVY:
        return POSE
    return LENS if count >= FOR_LENS else FOVY


def fit_camera(start: Camera, seen: Floats, places: Floats, free: int) -> Camera:
    """Fit a camera to places (n, 3) [m] that are seen at (n, 2), in image heights.

    ``free`` numbers are fitted, the others are those of ``start``: see `POSE`. Of its pose and
    OpenCV's global solutions, the fit begins at the one that sees the places best.
    """

    def errors(change: Floats, camera: Camera) -> Floats:
        return (_change(camera, change).see(places) - seen).ravel()

    none = np.zeros(free)
    cameras = _starts(start, seen, places)
    first = min(cameras, key=lambda camera: np.square(errors(none, camera)).sum())
    fit = least_squares(errors, none, method="lm", args=(first,))
    return _change(first, fit.x)


def _change(camera: Camera, change: Floats) -> Camera:
    """Change the first numbers of a camera: shift (3,) [m], turn (3,) [rad], zoom, lens."""
    full = np.append(change, np.zeros(LENS - len(change)))
    turn, _ = _cv2().Rodrigues(full[3:6])
    zoom = np.exp(full[6])
    lens = camera.lens.copy()
    lens[0] += full[7]
    return Camera(
        position=camera.position + full[:3],
        axes=camera.axes @ turn,
        focus=camera.focus * [zoom, zoom, 1, 1],
        lens=lens,
    )


def _starts(start: Camera, seen: Floats, places: Floats) -> list[Camera]:
    """Return a camera at its pose and at those of OpenCV's global solutions."""
    cv2 = _cv2()
    cameras = [start]
    with suppress(cv2.error):  # clicks that lie on each other
        _, rotations, translations, _ = cv2.solvePnPGeneric(
            places, seen, start.matrix, start.lens, flags=cv2.SOLVEPNP_SQPNP
        )
        for rotation, translation in zip(rotations, translations, strict=True):
            turn = cv2.Rodrigues(rotation)[0].T
            position = -turn @ translation[:, 0]
            cameras.append(replace(start, position=position, axes=turn * TO_OPENCV))
    return cameras


def bootstrap_cameras(
    camera: Camera, seen: Floats, places: Floats, free: int, count: int
) -> list[Camera]:
    """Return cameras fitted to ``count`` redrawn sets of clicks on the points.

    Clicks are redrawn around the fitted camera, with the standard error of those at hand, of at
    least `CLICK`.
    """
    generator = np.random.default_rng(0)
    drawn = camera.see(places)
    square = np.square(drawn - seen).sum() / max(seen.size - free, 1)
    error = max(CLICK, np.sqrt(square))
    cameras = []
    for _ in range(count):
        clicks = drawn + error * generator.standard_normal(drawn.shape)
        cameras.append(fit_camera(camera, clicks, places, free))
    return cameras


def _cv2() -> Any:
    """Import OpenCV."""
    with packages_of("camera", "Fitting a camera"):
        import cv2
    return cv2
