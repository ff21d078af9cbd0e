"""Checks of a real camera: a photograph over the simulated view, and the pose that fits points."""

import csv
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image, ImageOps
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from knowarm.arrays import Floats
from knowarm.check import Check
from knowarm.pictures import central_square
from knowarm.reading import read_text, reading, replacing
from knowarm.world.config import EnvConfig, scene_of
from knowarm.world.render.renderer import make_renderer
from knowarm.world.scene.appearance import resting_colours
from knowarm.world.scene.compose import ROBOT_PREFIX
from knowarm.world.scene.scene import Scene, target_places

SIDE, LEAST_POINTS = 480, 4  # Width and height of the overlay [px]
MAX_SHIFT_M, MAX_TURN_DEG, MAX_RESIDUAL = 0.01, 1.0, 0.01  # Last: in image heights


def check_camera(config: EnvConfig, photo: Path, points: Path | None, overlay: Path) -> list[Check]:
    """Write a PNG of a photograph's central square over the view of the arm at its start.

    ``points`` is a CSV file with ``point`` (a name of `named_points`, or "x y z" [m]), ``x`` and
    ``y``, its pixel from the upper left corner of the photograph; None fits nothing.
    """
    with reading(photo, "Give a photograph as PNG or JPEG."):
        image = ImageOps.exif_transpose(Image.open(photo)).convert("RGB")
    scene = scene_of(config)
    data = scene.at(scene.home)
    renderer = make_renderer(scene, replace(config, mesh_detail="full"), SIDE, 1)
    poses = data.geom_xpos[None], data.geom_xmat[None]
    view = Image.fromarray(renderer.draw(*poses, resting_colours(scene, 1))[0])
    with replacing(overlay) as temporary:
        Image.blend(central_square(image, SIDE), view, 0.5).save(temporary, "PNG")
    drawn = Check(name="overlay", ok=True, found=f"{overlay}, photograph and view by halves")
    if points is None:
        return [drawn]
    pixels, places = _read_points(points, named_points(scene, data))
    half_size = np.array(image.size) / 2
    seen = (pixels - half_size) / half_size.min() * [1, -1]
    return [drawn, *_compare(scene, *fit_camera(scene, seen, places))]


def named_points(scene: Scene, data: mujoco.MjData) -> dict[str, Floats]:
    """Return points (3,) [m], world, by name: gripper, origins of joints, rectangle."""
    robot = scene.robot
    joints = {name: data.joint(ROBOT_PREFIX + name).xanchor.copy() for name in robot.joints}
    centre, half = np.array(robot.rectangle_centre_m), np.array(robot.rectangle_half_size_m)
    corners = target_places(scene, centre + half * [(-1, -1), (-1, 1), (1, 1), (1, -1)])
    rectangle = {f"rectangle_{i + 1}": corner for i, corner in enumerate(corners)}
    return {"gripper": data.site_xpos[scene.tcp_site].copy(), **joints, **rectangle}


def fit_camera(scene: Scene, seen: Floats, places: Floats) -> tuple[Floats, Rotation, float, float]:
    """Fit a camera to points seen at (n, 2), in half image heights right and up from the centre.

    Returns position [m], rotation, field of view [deg] and largest error left [image heights].
    """
    start = Rotation.from_matrix(scene.camera_matrix)
    half_height = np.tan(np.radians(scene.robot.camera_fovy_deg) / 2)

    def errors(change: Floats) -> Floats:
        turned = start * Rotation.from_rotvec(change[3:6])
        local = turned.inv().apply(places - scene.camera_position - change[:3])
        depth = np.maximum(-local[:, 2:], 1e-3) * half_height * np.exp(change[6])
        weak = 1e-3 * change[6:]  # few points do not tell the field of view from the distance
        return np.concatenate([(local[:, :2] / depth - seen).ravel(), weak])

    found = least_squares(errors, np.zeros(7))
    fovy_deg = float(np.degrees(2 * np.arctan(half_height * np.exp(found.x[6]))))
    turned = start * Rotation.from_rotvec(found.x[3:6])
    return scene.camera_position + found.x[:3], turned, fovy_deg, float(abs(found.fun).max() / 2)


def _read_points(path: Path, points: dict[str, Floats]) -> tuple[Floats, Floats]:
    """Read pixels (n, 2) and places (n, 3) [m]."""
    remedy = "Give the columns point, x and y, one row per clicked pixel."
    text = read_text(path, remedy=remedy)
    with reading(path, remedy):
        rows = list(csv.DictReader(text.splitlines()))
        for name in (row["point"] for row in rows):
            if name not in points and len(name.split()) != 3:
                raise ValueError(f"unknown point {name!r}; known: {', '.join(points)}, or 'x y z'")
        places = np.array([points.get(row["point"], row["point"].split()) for row in rows], float)
        pixels = np.array([(row["x"], row["y"]) for row in rows], float)
        if len(rows) < LEAST_POINTS or not np.isfinite([pixels.sum(), places.sum()]).all():
            raise ValueError(f"{len(rows)} points; give at least {LEAST_POINTS} finite ones")
    return pixels, places


def _compare(
    scene: Scene, position: Floats, turned: Rotation, fovy_deg: float, residual: float
) -> list[Check]:
    """Compare a fitted camera with the robot's."""
    robot, ahead = scene.robot, turned.apply([0, 0, -1])
    reach = np.linalg.norm(np.subtract(robot.camera_look_at_m, robot.camera_position_m))
    shift_m = np.linalg.norm(position - scene.camera_position)
    turn = np.degrees((Rotation.from_matrix(scene.camera_matrix).inv() * turned).magnitude())
    roll = np.degrees(np.arcsin(turned.apply([1, 0, 0])[2] / np.hypot(*ahead[:2])))
    wider = fovy_deg - robot.camera_fovy_deg
    remedy = (
        f"Move the camera back, or write camera_position_m = {position.round(3).tolist()}, "
        f"camera_look_at_m = {(position + reach * ahead).round(3).tolist()}, camera_fovy_deg = "
        f"{fovy_deg:.1f} into the robot's description, which has level cameras only."
    )
    again = "A point, the pose of the arm or the lens (distortion) is wrong."
    rows = (
        ("fit", 100 * residual, 100 * MAX_RESIDUAL, "% of the image's height", again),
        ("position", 1000 * shift_m, 1000 * MAX_SHIFT_M, "mm off", remedy),
        ("rotation", turn, MAX_TURN_DEG, f"degrees off, {roll:+.1f} from level", remedy),
        ("field of view", wider, MAX_TURN_DEG, "degrees wider", remedy),
    )
    checks = [Check(n, bool(abs(v) <= m), f"{v:z.1f} {u}", r) for n, v, m, u, r in rows]
    return checks if checks[0].ok else checks[:1]  # no camera sees these points
