"""Camera of a drafted robot: the view, and the start pose, that show most of targets and arm."""

import copy
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from math import radians, tan

import numpy as np
from mujoco import mju_mat2Quat

from knowarm.arrays import Floats
from knowarm.own_robot.draft_chain import box_corners
from knowarm.own_robot.draft_home import Home
from knowarm.own_robot.draft_reach import NODES
from knowarm.own_robot.pixels import SceneImages, different_pixels, robot_parts
from knowarm.own_robot.poses import Fields, place_targets, rounded, support_places
from knowarm.world.config import EnvConfig
from knowarm.world.scene.compose import level_axes
from knowarm.world.scene.scene import Scene

FOVY_DEG = 40.0
MARGIN = 0.9  # Share of the image within which everything must lie
VIEWS = {
    "right in front and above": (0.62, -0.62, 0.48),
    "left in front and above": (0.62, 0.62, 0.48),
    "right in front and high above": (0.5, -0.5, 0.71),
    "left in front and high above": (0.5, 0.5, 0.71),
    "at the right and above": (0.2, -0.85, 0.49),
    "at the left and above": (0.2, 0.85, 0.49),
}
"""Directions from what is looked at to the camera, preferred first."""

ENOUGH_PIXELS = 24
"""Pixels of every target at every place with which the first view is taken."""

ENOUGH_ROBOT = 0.03
"""Share of the image that shows the robot with which the first view is taken."""


FIELDS = ("camera_position_m", "camera_look_at_m", "camera_fovy_deg")


def choose_view(
    scene: Scene, homes: Sequence[Home], given: Fields
) -> tuple[Home, Fields, str]:
    """Choose start pose and camera: the first that show enough of targets and arm, or most of them.

    Fields of the camera that are given are kept. Return the fields of the camera and a description.
    """
    views = VIEWS
    kept = {field: given[field] for field in FIELDS if field in given}
    if len(kept) == len(FIELDS):
        views = {"as given": VIEWS["right in front and above"]}
    most = -1.0
    for home, (name, direction) in product(homes, views.items()):
        view = _frame(scene, home, np.array(direction), given["camera_fovy_deg"])
        view |= kept
        pixels, robot = _shown(scene, home, view)
        score = min(pixels / ENOUGH_PIXELS, robot / ENOUGH_ROBOT, 1.0)
        if score > most:
            most = score
            text = (
                f"{name}: at its start the arm fills {100 * robot:.1f} % of the image, and every "
                f"target at least {pixels:.0f} pixels"
            )
            best = (home, view, text)
        if score >= 1:
            break
    return best


def _frame(scene: Scene, home: Home, direction: Floats, fovy_deg: float) -> Fields:
    """Place a camera so that it shows the rectangle with its targets, and the arm."""
    data = scene.at(home.joints)
    top = scene.grasp_position[:, 2].max() * 1.2
    places = support_places(scene, NODES[1:])
    parts = np.flatnonzero(robot_parts(scene))
    ends = box_corners(data, parts).reshape(-1, 3)
    ends = ends[ends[:, 2] > -0.01]  # below the floor nothing is seen
    tip = data.site_xpos[scene.tcp_site]
    above = places + np.array([0, 0, top])
    points = np.vstack([places, above, ends, tip])
    look_at = (points.max(axis=0) + points.min(axis=0)) / 2
    axes = level_axes(direction)
    local = (points - look_at) @ axes
    slope = tan(radians(fovy_deg) / 2) * MARGIN
    beside = np.abs(local[:, :2]).max(axis=1)
    distances = beside / slope
    distances += local[:, 2]
    distance = distances.max()
    position = look_at + distance * axes[:, 2]
    return {
        "camera_position_m": rounded(position),
        "camera_look_at_m": rounded(look_at),
    }


def _shown(scene: Scene, home: Home, view: Fields) -> tuple[float, float]:
    """Return the least pixels of a target at a place, and the share of the image with the robot."""
    model = copy.copy(scene.model)
    position = np.array(view["camera_position_m"])
    axes = level_axes(position - view["camera_look_at_m"])
    camera = scene.camera
    model.cam_pos[camera] = position
    model.cam_fovy[camera] = view["camera_fovy_deg"]
    mju_mat2Quat(model.cam_quat[camera], axes.ravel())
    simulation = place_targets(scene, home.joints, NODES)
    viewed = replace(scene, model=model)
    images = SceneImages(viewed, simulation, EnvConfig())
    drawn = [images.targets([k]) for k in range(len(scene.targets))]
    least = different_pixels(np.stack(drawn), images.empty).min()
    share = images.robot_pixels()[0] / EnvConfig.image_size**2
    return float(least), float(share)
