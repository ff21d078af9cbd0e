"""Camera fitted to points of a photograph by OpenCV, with intervals by bootstrap."""

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image
from scipy.optimize import least_squares

from knowarm.arrays import Floats
from knowarm.errors import packages_of
from knowarm.pictures import central_square, rectified
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.compose import level_axes, roll

TO_OPENCV = np.array([1.0, -1.0, -1.0])
"""Signs of the axes from x right, y up, z backward to OpenCV's x right, y down, z forward."""

SIDE = 1000.0  # Height of the image in which OpenCV computes [px]
LEAST_POINTS = 4
POSE = 6
"""Numbers of a pose; the seventh that is fitted is the field of view, the eighth the lens (k1)."""

FOVY = 7
LENS = 8
FOR_FOVY = 6  # Points from which the field of view is fitted, too
FOR_LENS = 9  # Points from which barrel and pincushion distortion is
CLICK = 1 / 480
"""Least standard error of a click that intervals assume [image heights]."""


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A camera in the frame of the robot's base, whose images are seen in image heights."""

    position: Floats  # World [m], (3,)
    axes: Floats  # Right, up and backward as columns, (3, 3)
    focus: (
        Floats  # Focal lengths along x and y, principal point from the upper left, (4,)
    )
    lens: Floats  # k1, k2, p1, p2, k3, (5,)

    def see(self, places: Floats) -> Floats:
        """Project places (n, 3) [m] into the image, (n, 2): right and down from the corner."""
        points, _ = _cv2().projectPoints(
            places, *_pose(self), _matrix(self.focus), self.lens
        )
        return np.asarray(points.reshape(-1, 2) / SIDE)

    @property
    def fovy_deg(self) -> float:
        """The vertical field of view of the whole image."""
        return float(np.degrees(2 * np.arctan(0.5 / self.focus[1])))

    @property
    def roll_deg(self) -> float:
        """The turn about the optical axis from level, right side down."""
        level = level_axes(self.axes[:, 2])
        right = level.T @ self.axes[:, 0]
        return float(np.degrees(np.arctan2(-right[1], right[0])))


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
        lens=np.pad(robot.camera_distortion, (0, 5 - len(robot.camera_distortion))),
    )


def most_free(count: int, robot: Robot) -> int:
    """Return how many numbers of a camera are fitted to a count of points."""
    if robot.camera_intrinsics is not None or count < FOR_FOVY:
        return POSE
    return LENS if count >= FOR_LENS else FOVY


def fit_camera(start: Camera, seen: Floats, places: Floats, free: int) -> Camera:
    """Fit a camera to places (n, 3) [m] that are seen at (n, 2), in image heights.

    ``free`` numbers are fitted, the others are those of ``start``: see `POSE`.
    """
    pixels = np.ascontiguousarray(seen * SIDE)
    rotation, translation = _start(start, pixels, places)
    matrix = _matrix(start.focus)
    first = np.concatenate([rotation.ravel(), translation.ravel(), [0.0, 0.0]])

    def camera(values: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        full = np.append(values, np.zeros(LENS - free))
        zoomed = matrix.copy()
        zoomed[[0, 1], [0, 1]] *= np.exp(full[6])
        lens = start.lens.copy()
        lens[0] += full[7]
        return full[:3], full[3:6], zoomed, lens

    def errors(values: Floats) -> Floats:
        drawn, _ = _cv2().projectPoints(places, *camera(values))
        return np.asarray((drawn.reshape(-1, 2) - pixels).ravel())

    def slopes(values: Floats) -> Floats:
        _, _, zoomed, _ = camera(values)
        _, change = _cv2().projectPoints(places, *camera(values))
        zoom = change[:, 6] * zoomed[0, 0] + change[:, 7] * zoomed[1, 1]
        return np.column_stack([change[:, :6], zoom, change[:, 10]])[:, :free]

    fit = least_squares(errors, first[:free], jac=slopes, method="lm")
    rotation, translation, matrix, lens = camera(fit.x)
    turn = _cv2().Rodrigues(rotation)[0]
    return Camera(
        position=-turn.T @ translation,
        axes=turn.T * TO_OPENCV,
        focus=np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]) / SIDE,
        lens=lens,
    )


def _start(start: Camera, pixels: Floats, places: Floats) -> tuple[Floats, Floats]:
    """Return the pose of OpenCV's global solution, or of the start where that is better."""
    cv2 = _cv2()
    matrix = _matrix(start.focus)
    best = _pose(start)
    least = np.inf
    candidates = [best]
    with suppress(cv2.error):  # clicks that lie on each other
        count, rotations, translations, _ = cv2.solvePnPGeneric(
            places, pixels, matrix, start.lens, flags=cv2.SOLVEPNP_SQPNP
        )
        candidates += zip(rotations[:count], translations[:count], strict=True)
    for rotation, translation in candidates:
        refined = cv2.solvePnPRefineLM(
            places, pixels, matrix, start.lens, rotation.copy(), translation.copy()
        )
        drawn, _ = cv2.projectPoints(places, *refined, matrix, start.lens)
        error = float(np.square(drawn.reshape(-1, 2) - pixels).sum())
        if error < least:
            least = error
            best = refined
    return best


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
    error = max(CLICK, float(np.sqrt(square)))
    cameras = []
    for _ in range(count):
        clicks = drawn + error * generator.standard_normal(drawn.shape)
        cameras.append(fit_camera(camera, clicks, places, free))
    return cameras


def rectify(image: Image.Image, robot: Robot, side: int) -> Image.Image:
    """Return what the policy's camera sees of a photograph, ``side`` pixels wide and high.

    Of a description without intrinsics it is the central square.
    """
    if robot.camera_intrinsics is None:
        return central_square(image, side)
    return rectified(
        image,
        side,
        robot.camera_fovy_deg,
        robot.camera_intrinsics,
        robot.camera_distortion,
    )


def _cv2() -> Any:
    """Import OpenCV."""
    with packages_of("camera", "Fitting a camera"):
        import cv2
    return cv2


def _matrix(focus: Floats) -> Floats:
    """Return OpenCV's camera matrix [px]."""
    x, y, centre_x, centre_y = focus * SIDE
    return np.array([[x, 0, centre_x], [0, y, centre_y], [0, 0, 1]])


def _pose(camera: Camera) -> tuple[Floats, Floats]:
    """Return OpenCV's rotation and translation from the world to a camera."""
    turn = (camera.axes * TO_OPENCV).T
    rotation = _cv2().Rodrigues(turn)[0]
    return rotation, -(turn @ camera.position)[:, None]
