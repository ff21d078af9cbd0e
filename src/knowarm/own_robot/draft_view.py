"""Camera of a drafted robot: the view, and the start pose, that show most of targets and arm."""

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from knowarm.arrays import Floats
from knowarm.own_robot.draft_home import Home
from knowarm.own_robot.draft_reach import NODES
from knowarm.own_robot.pixels import different_pixels, robot_parts
from knowarm.world.backend import MujocoSimulator
from knowarm.world.config import EnvConfig
from knowarm.world.render.renderer import make_renderer
from knowarm.world.scene.appearance import TargetColours, resting_colours
from knowarm.world.scene.compose import CAMERA, level_axes
from knowarm.world.scene.scene import Scene, target_places

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

ENOUGH_PIXELS, ENOUGH_ROBOT = 24, 0.03
"""Pixels of every target at every place, and share of the image that shows the robot, with which
the first view is taken."""


def choose_view(
    scene: Scene, homes: Sequence[Home], given: Mapping[str, Any]
) -> tuple[Home, dict[str, Any], str]:
    """Choose start pose and camera: the first that show enough of targets and arm, or most of them.

    Fields of the camera that are given are kept. Return the fields of the camera and a description.
    """
    best: tuple[float, Home, dict[str, Any], str] | None = None
    fixed = {"camera_position_m", "camera_look_at_m"} <= set(given)
    for home in homes:
        for name, direction in list(VIEWS.items())[: 1 if fixed else None]:
            view = {**_frame(scene, home, np.array(direction), given["camera_fovy_deg"]), **given}
            pixels, robot = _shown(scene, home, view)
            score = min(pixels / ENOUGH_PIXELS, robot / ENOUGH_ROBOT, 1.0)
            text = (
                f"{'as given' if fixed else name}: at its start the arm fills {100 * robot:.1f} % "
                f"of the image, and every target at least {pixels:.0f} pixels"
            )
            if best is None or score > best[0]:
                best = score, home, view, text
            if score >= 1:
                break
        if best is not None and best[0] >= 1:
            break
    assert best is not None, "there are start poses and views"
    _, home, view, text = best
    fields = ("camera_position_m", "camera_look_at_m", "camera_fovy_deg")
    return home, {name: view[name] for name in fields}, text


def _frame(scene: Scene, home: Home, direction: Floats, fovy_deg: float) -> dict[str, Any]:
    """Place a camera so that it shows the rectangle with its targets, and the arm."""
    robot, model = scene.robot, scene.model
    data = scene.at(home.joints)
    heights = np.array([0.0, float(scene.grasp_position[:, 2].max()) * 1.2])
    corners = np.array(robot.rectangle_centre_m) + NODES[1:] * robot.rectangle_half_size_m
    places = np.repeat(target_places(scene, corners), 2, axis=0)
    places[:, 2] += np.tile(heights, len(corners))
    geoms = np.flatnonzero(robot_parts(scene))
    signs = np.stack(np.meshgrid(*[(-1, 1)] * 3), axis=-1).reshape(-1, 3)
    box = model.geom_aabb[geoms, None, :3] + signs * model.geom_aabb[geoms, None, 3:]
    turned = np.einsum("gij,gcj->gci", data.geom_xmat[geoms].reshape(-1, 3, 3), box)
    ends = (data.geom_xpos[geoms, None] + turned).reshape(-1, 3)
    ends = ends[ends[:, 2] > -0.01]  # below the floor nothing is seen
    points = np.concatenate([places, ends, data.site_xpos[[scene.tcp_site]]])
    look_at = (points.max(axis=0) + points.min(axis=0)) / 2
    axes = level_axes(direction)
    local = (points - look_at) @ axes
    slope = math.tan(math.radians(fovy_deg) / 2) * MARGIN
    distance = float((np.abs(local[:, :2]).max(axis=1) / slope + local[:, 2]).max())
    position = look_at + distance * axes[:, 2]
    return {
        "camera_position_m": np.round(position, 4).tolist(),
        "camera_look_at_m": np.round(look_at, 4).tolist(),
    }


def _shown(scene: Scene, home: Home, view: Mapping[str, Any]) -> tuple[float, float]:
    """Return the least pixels of a target at a place, and the share of the image with the robot."""
    model = copy.copy(scene.model)
    position, look_at = np.array(view["camera_position_m"]), np.array(view["camera_look_at_m"])
    camera = model.camera(CAMERA)
    camera.pos, camera.fovy = position, view["camera_fovy_deg"]
    mujoco.mju_mat2Quat(model.cam_quat[scene.camera], level_axes(position - look_at).ravel())
    count, size = len(NODES), EnvConfig.image_size
    simulation = MujocoSimulator(scene, count, 1, "kinematic")
    places = np.array(scene.robot.rectangle_centre_m) + NODES * scene.robot.rectangle_half_size_m
    everything = np.repeat(places[:, None], len(scene.targets), axis=1)
    simulation.reset(np.arange(count), np.tile(home.joints, (count, 1)), everything)
    renderer = make_renderer(replace(scene, model=model), EnvConfig(), size)
    poses = simulation.geom_position, simulation.geom_matrix
    colours = resting_colours(scene, count)
    empty = renderer.draw(*poses, colours).astype(np.int16)
    paint, first = TargetColours(scene), np.zeros(count, dtype=np.int64)
    least = [
        different_pixels(renderer.draw(*poses, paint(first + k, first)), empty).min()
        for k in range(len(scene.targets))
    ]
    colours[:, robot_parts(scene), 3] = 0.0
    robot = different_pixels(renderer.draw(*poses, colours), empty)
    return float(min(least)), float(robot[0]) / size**2
