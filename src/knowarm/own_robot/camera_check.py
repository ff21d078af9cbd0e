"""Checks of a real camera: a photograph over the simulated view, and the pose that fits points."""

import csv
import math
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from PIL import Image, ImageOps
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from knowarm.arrays import Floats
from knowarm.check import Check
from knowarm.own_robot.pixels import draw_large
from knowarm.own_robot.poses import CORNERS, rectangle_places
from knowarm.pictures import central_square
from knowarm.reading import read_text, reading, replacing
from knowarm.world.config import EnvConfig, scene_of
from knowarm.world.scene.appearance import resting_colours
from knowarm.world.scene.compose import ROBOT_PREFIX
from knowarm.world.scene.scene import Scene, target_places

SIDE = 480  # Width and height of the overlay [px]
LEAST_POINTS = 4  # From which a camera is fitted
MAX_SHIFT_M = 0.01
MAX_TURN_DEG = 1.0  # Also of the field of view
MAX_RESIDUAL = 0.01  # In image heights


class FittedCamera(NamedTuple):
    """A camera that fits points."""

    position: Floats  # World [m], (3,)
    rotation: Rotation  # From camera (x right, y up, z backward) to world
    fovy_deg: float  # Vertical field of view
    residual: float  # Largest error left [image heights]


def check_camera(
    config: EnvConfig, photo: Path, points: Path | None, overlay: Path
) -> list[Check]:
    """Write a PNG of a photograph's central square over the view of the arm at its start.

    ``points`` is a CSV file with ``point`` (a name of `named_points`, or "x y z" [m]), ``x`` and
    ``y``, its pixel from the upper left corner of the photograph; None fits nothing.
    """
    with reading(photo, "Give a photograph as PNG or JPEG."):
        image = ImageOps.exif_transpose(Image.open(photo)).convert("RGB")
    scene = scene_of(config)
    data = scene.at(scene.home)
    view = draw_large(scene, config, data, resting_colours(scene, 1), SIDE)
    blended = Image.blend(central_square(image, SIDE), view, 0.5)
    with replacing(overlay) as temporary:
        blended.save(temporary, "PNG")
    drawn = Check("overlay", True, f"{overlay}, photograph and view by halves")
    if points is None:
        return [drawn]
    pixels, places = _read_points(points, named_points(scene, data))
    half_size = np.array(image.size) / 2
    seen = (pixels - half_size) / half_size.min() * [1, -1]
    return [drawn, *_compare(scene, fit_camera(scene, seen, places))]


def named_points(scene: Scene, data: mujoco.MjData) -> dict[str, Floats]:
    """Return points (3,) [m], world, by name: gripper, origins of joints, rectangle."""
    points = {"gripper": data.site_xpos[scene.tcp_site].copy()}
    for name in scene.robot.joints:
        points[name] = data.joint(ROBOT_PREFIX + name).xanchor.copy()
    corners = target_places(scene, rectangle_places(scene.robot, CORNERS))
    for number, corner in enumerate(corners, start=1):
        points[f"rectangle_{number}"] = corner
    return points


def fit_camera(scene: Scene, seen: Floats, places: Floats) -> FittedCamera:
    """Fit a camera to points seen at (n, 2), in half image heights right and up from the centre."""
    start = Rotation.from_matrix(scene.camera_matrix)
    half_height = np.tan(np.radians(scene.robot.camera_fovy_deg) / 2)

    def errors(change: Floats) -> Floats:
        turned = start * Rotation.from_rotvec(change[3:6])
        local = turned.inv().apply(places - scene.camera_position - change[:3])
        depth = np.maximum(-local[:, 2:], 1e-3) * half_height * np.exp(change[6])
        # Few points do not tell the field of view from the distance.
        weak = 1e-3 * change[6:]
        return np.concatenate([(local[:, :2] / depth - seen).ravel(), weak])

    fit = least_squares(errors, np.zeros(7))
    return FittedCamera(
        position=scene.camera_position + fit.x[:3],
        rotation=start * Rotation.from_rotvec(fit.x[3:6]),
        fovy_deg=float(np.degrees(2 * np.arctan(half_height * np.exp(fit.x[6])))),
        residual=float(abs(fit.fun).max() / 2),
    )


def _read_points(path: Path, known: dict[str, Floats]) -> tuple[Floats, Floats]:
    """Read pixels (n, 2) and places (n, 3) [m]."""
    remedy = "Give the columns point, x and y, one row per clicked pixel."
    text = read_text(path, remedy=remedy)
    with reading(path, remedy):
        rows = list(csv.DictReader(text.splitlines()))
        names = [row["point"] for row in rows]
        for name in names:
            if name not in known and len(name.split()) != 3:
                raise ValueError(
                    f"unknown point {name!r}; known: {', '.join(known)}, or 'x y z'"
                )
        places = np.array([known.get(name, name.split()) for name in names], float)
        pixels = np.array([(row["x"], row["y"]) for row in rows], float)
        is_finite = np.isfinite([pixels.sum(), places.sum()]).all()
        if len(rows) < LEAST_POINTS or not is_finite:
            raise ValueError(
                f"{len(rows)} points; give at least {LEAST_POINTS} finite ones"
            )
    return pixels, places


def _compare(scene: Scene, camera: FittedCamera) -> list[Check]:
    """Compare a fitted camera with the robot's."""
    robot = scene.robot
    ahead = camera.rotation.apply([0, 0, -1])
    rightward = camera.rotation.apply([1, 0, 0])
    distance_m = math.dist(robot.camera_look_at_m, robot.camera_position_m)
    look_at = camera.position + distance_m * ahead
    shift_m = math.dist(camera.position, scene.camera_position)
    turn = Rotation.from_matrix(scene.camera_matrix).inv() * camera.rotation
    roll_deg = np.degrees(np.arcsin(rightward[2] / np.hypot(*ahead[:2])))
    remedy = (
        f"Move the camera back, or write camera_position_m = {camera.position.round(3).tolist()}, "
        f"camera_look_at_m = {look_at.round(3).tolist()}, camera_fovy_deg = "
        f"{camera.fovy_deg:.1f} into the robot's description, which has level cameras only."
    )
    fit = _limited(
        "fit",
        100 * camera.residual,
        100 * MAX_RESIDUAL,
        "% of the image's height",
        "A point, the pose of the arm or the lens (distortion) is wrong.",
    )
    if not fit.ok:
        return [fit]  # no camera sees these points
    turn_deg = np.degrees(turn.magnitude())
    wider_deg = camera.fovy_deg - robot.camera_fovy_deg
    level = f"degrees off, {roll_deg:+.1f} from level"
    return [
        fit,
        _limited("position", 1000 * shift_m, 1000 * MAX_SHIFT_M, "mm off", remedy),
        _limited("rotation", turn_deg, MAX_TURN_DEG, level, remedy),
        _limited("field of view", wider_deg, MAX_TURN_DEG, "degrees wider", remedy),
    ]


def _limited(name: str, value: float, limit: float, unit: str, remedy: str) -> Check:
    """Check that a value is at most a limit on either side of 0."""
    return Check(name, bool(abs(value) <= limit), f"{value:z.1f} {unit}", remedy)
