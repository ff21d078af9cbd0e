"""Checks of a real camera: a photograph over the simulated view, and the camera of its points."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from mujoco import MjData
from numpy.linalg import norm
from PIL import Image, ImageOps

from knowarm.arrays import Floats
from knowarm.check import Check
from knowarm.errors import packages_of
from knowarm.fence import fenced
from knowarm.own_robot.camera_fit import (
    FOVY,
    LEAST_POINTS,
    LENS,
    NUMBERS,
    Camera,
    bootstrap_cameras,
    camera_of,
    fit_camera,
    most_free,
)
from knowarm.own_robot.pixels import draw_once
from knowarm.own_robot.poses import CORNERS, Fields, rounded, support_places
from knowarm.pictures import central_square
from knowarm.reading import read_text, reading, replacing
from knowarm.world.config import EnvConfig, scene_of
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.appearance import resting_colours
from knowarm.world.scene.compose import ROBOT_PREFIX
from knowarm.world.scene.scene import Scene

SIDE = 480  # Width and height of the overlay [px]
LEAST_SPREAD_M = 0.02  # Of the points beside the line on which most lie
MAX_RESIDUAL = 0.01  # Of the points, root mean square, in image heights
MAX_MOVED = 0.4
"""Largest motion of the policy's pixels by a wrong camera, root mean square [px]; 1 cm or 1 degree
moves them by .5 to 1.5 of 64, and costs a third of the success."""

PHOTO = "Give a photograph as PNG or JPEG."

CAMERAS = 100  # Fitted to redrawn clicks
CONFIDENCE = 0.95


def check_camera(
    config: EnvConfig, photo: Path, points: Path | None, overlay: Path
) -> list[Check]:
    """Write a PNG of a photograph's central square over the view of the arm at its start.

    ``points`` is a CSV file with ``point`` (a name of `named_points`, or "x y z" [m]), ``x`` and
    ``y``, its pixel from the upper left corner of the photograph; None fits nothing.
    """
    with reading(photo, PHOTO):
        image = fenced(_decode, photo)
    scene = scene_of(config)
    data = scene.at(scene.home)
    view = draw_once(scene, config, data, resting_colours(scene, 1), SIDE)
    blended = Image.blend(rectify(image, scene.robot, SIDE), view, 0.5)
    with replacing(overlay) as temporary:
        blended.save(temporary, "PNG")
    drawn = Check("overlay", True, f"{overlay}, photograph and view by halves")
    if points is None:
        return [drawn]
    pixels, places = _read_points(points, named_points(scene, data))
    aspect = image.width / image.height
    return [drawn, *_compare(scene, config, aspect, pixels / image.height, places)]


def _decode(photo: Path) -> Image.Image:
    with Image.open(photo) as image:
        return ImageOps.exif_transpose(image).convert("RGB")


def rectify(image: Image.Image, robot: Robot, side: int) -> Image.Image:
    """Return what the policy's camera sees of a photograph, ``side`` pixels wide and high.

    Of a description without intrinsics it is the central square.
    """
    if robot.camera_intrinsics is None:
        return central_square(image, side)
    with packages_of("camera", "Rectifying images"):
        import cv2
    x, y, centre_x, centre_y = np.array(robot.camera_intrinsics) * image.height
    # OpenCV counts from the middle of the first pixel.
    matrix = np.array([[x, 0, centre_x - 0.5], [0, y, centre_y - 0.5], [0, 0, 1]])
    focal_length = side / 2 / np.tan(np.radians(robot.camera_fovy_deg) / 2)
    middle = (side - 1) / 2
    wanted = np.array([[focal_length, 0, middle], [0, focal_length, middle], [0, 0, 1]])
    distortion = np.array([*robot.camera_distortion] or [0.0] * 5)
    maps = cv2.initUndistortRectifyMap(
        matrix, distortion, None, wanted, (side, side), cv2.CV_32FC1
    )
    return Image.fromarray(cv2.remap(np.asarray(image), *maps, cv2.INTER_LINEAR))


def named_points(scene: Scene, data: MjData) -> dict[str, Floats]:
    """Return points (3,) [m], world, by name: gripper, origins of joints, rectangle."""
    points = {"gripper": data.site_xpos[scene.tcp_site].copy()}
    for name in scene.robot.joints:
        points[name] = data.joint(ROBOT_PREFIX + name).xanchor.copy()
    for number, corner in enumerate(support_places(scene, CORNERS), start=1):
        points[f"rectangle_{number}"] = corner
    return points


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
        # Singular values: the spread along the line on which most lie, and beside it
        spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if spread[1] < LEAST_SPREAD_M:
            raise ValueError(
                "the points lie on one line; give different places, not all on it"
            )
    return pixels, places


def _compare(
    scene: Scene, config: EnvConfig, aspect: float, clicks: Floats, places: Floats
) -> list[Check]:
    """Fit a camera to clicked points, and compare it with the robot's.

    Args:
        scene: with the robot whose camera is checked.
        config: of the policy's images.
        aspect: width of the photograph relative to its height.
        clicks: where the points were clicked, (n, 2), in image heights.
        places: where they are, world, (n, 3) [m].
    """
    robot = scene.robot
    described = camera_of(robot, aspect)
    free = most_free(len(places), robot)
    camera = fit_camera(described, clicks, places, free)
    offsets = camera.see(places) - clicks
    worst = int(norm(offsets, axis=1).argmax()) + 1
    residual = _rms(offsets)
    fit = Check(
        "fit",
        residual <= MAX_RESIDUAL,
        f"points lie {100 * residual:.2f} % of the image's height from where the fitted camera "
        "sees them (root mean square)",
        f"More than {100 * MAX_RESIDUAL:.0f} %: a point is wrong, most likely number {worst}, or "
        "the pose of the arm is.",
    )
    if not fit.ok:
        return [fit]  # no camera sees these points
    cameras = bootstrap_cameras(camera, clicks, places, free, CAMERAS)
    low, high = _intervals(cameras)
    # A distortion whose interval holds 0 is not fitted: it would only follow the clicks' noise.
    if free == LENS and low[-1] <= 0 <= high[-1]:
        free = FOVY
        camera = fit_camera(described, clicks, places, free)
        cameras = bootstrap_cameras(camera, clicks, places, free, CAMERAS)
    # What the policy looks at: the rectangle's corners, on the support and at the objects' height
    corners = support_places(scene, CORNERS)
    top = [0.0, 0.0, scene.grasp_position[:, 2].max()]
    looked_at = np.vstack([corners, corners + top, places])
    half_height = described.focus[1] * np.tan(np.radians(robot.camera_fovy_deg) / 2)
    to_pixels = config.image_size / 2 / half_height
    fitted = camera.see(looked_at)
    moved = to_pixels * _rms(fitted - described.see(looked_at))
    noise = [to_pixels * _rms(redrawn.see(looked_at) - fitted) for redrawn in cameras]
    unsure = float(np.quantile(noise, CONFIDENCE))
    pose = Check("camera", True, _describe(camera, cameras))
    verdict = Check(
        "pixels of the policy",
        bool(moved**2 <= MAX_MOVED**2 + unsure**2),
        f"move by {moved:.2f} of {config.image_size} (root mean square); clicks leave "
        f"{unsure:.2f} open",
        f"More than {MAX_MOVED}: move the camera back, or write into the robot's description "
        f"{_fields(robot, camera, free, aspect)}.",
    )
    return [fit, pose, verdict]


def _rms(offsets: Floats) -> float:
    """Return the root mean square of the lengths of offsets (n, 2)."""
    return float(np.sqrt(np.square(offsets).sum(axis=1).mean()))


def _intervals(cameras: Sequence[Camera]) -> Floats:
    """Return lower and upper ends of the numbers of cameras fitted to redrawn clicks, (2, 6)."""
    values = [camera.numbers for camera in cameras]
    shares = [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2]
    return np.quantile(values, shares, axis=0)


def _describe(camera: Camera, cameras: Sequence[Camera]) -> str:
    """Return a camera's numbers with their intervals; those that are not fitted are left out."""
    texts = []
    columns = zip(NUMBERS.items(), camera.numbers, *_intervals(cameras), strict=True)
    for (name, unit), value, low, high in columns:
        if low < high:
            texts.append(f"{name} {value:.3f} [{low:.3f}, {high:.3f}] {unit}".strip())
    return ", ".join(texts)


def _fields(robot: Robot, camera: Camera, free: int, aspect: float) -> str:
    """Return the fields of a description that make a camera the robot's, as TOML."""
    distance_m = math.dist(robot.camera_look_at_m, robot.camera_position_m)
    look_at = camera.position - distance_m * camera.axes[:, 2]
    fields: Fields = {
        "camera_position_m": rounded(camera.position),
        "camera_look_at_m": rounded(look_at),
        "camera_roll_deg": round(camera.roll_deg, 2),
    }
    if free >= FOVY:
        square = min(1.0, aspect)  # Which the policy sees
        fields["camera_fovy_deg"] = round(camera.fovy_deg(square), 2)
    if free >= LENS:
        fields["camera_intrinsics"] = camera.focus.round(5).tolist()
        fields["camera_distortion"] = camera.lens.round(5).tolist()
    return ", ".join(f"{name} = {value}" for name, value in fields.items())
