"""Image of a robot's scene: the start pose, the rectangle of the targets, what the policy sees."""

from pathlib import Path

import numpy as np
from mujoco import MjData, mj_kinematics
from PIL import Image, ImageDraw

from knowarm.arrays import Floats
from knowarm.own_robot.pixels import draw_once
from knowarm.own_robot.poses import CORNERS, support_places
from knowarm.reading import replacing
from knowarm.world.config import EnvConfig
from knowarm.world.scene.appearance import TargetColours
from knowarm.world.scene.scene import Scene, project

SIDE = 512  # Side of each of the two images [px]
LINE = (255, 210, 60)  # Colour of the rectangle and of the gripper's approach
APPROACH_M = 0.1  # Length of the line that shows the gripper's approach [m]


def write_scene_image(scene: Scene, config: EnvConfig, path: Path) -> None:
    """Draw the arm at its start with the targets at corners of the rectangle, and write a PNG."""
    data = scene.at(scene.home)
    count = len(scene.targets)
    corners = support_places(scene, CORNERS)
    data.mocap_pos[scene.target_mocap] = np.resize(corners, (count, 3))
    mj_kinematics(scene.model, data)
    targets = np.arange(count)[None]
    colours = TargetColours(scene)(targets, np.zeros_like(targets))
    large = draw_once(scene, config, data, colours, SIDE)
    _draw_lines(scene, data, corners, large)
    small = draw_once(scene, config, data, colours, config.image_size)
    small = small.resize(large.size, Image.Resampling.NEAREST)
    both = Image.new("RGB", (2 * SIDE, SIDE))
    both.paste(large)
    both.paste(small, (SIDE, 0))
    with replacing(path) as temporary:
        both.save(temporary)


def _draw_lines(
    scene: Scene, data: MjData, corners: Floats, image: Image.Image
) -> None:
    """Draw the rectangle and the gripper's approach over an image of the scene."""
    site = data.site(scene.tcp_site)
    tip = site.xpos
    approach = site.xmat.reshape(3, 3)[:, 2]
    rectangle = np.vstack([corners, corners[:1]])
    ahead = np.vstack([tip, tip + APPROACH_M * approach])
    pen = ImageDraw.Draw(image)
    for points in (rectangle, ahead):
        right_and_down = project(scene, points) * [1, -1]
        pixels = (right_and_down + 1) * SIDE / 2
        if np.isfinite(pixels).all():
            pen.line(pixels.ravel().tolist(), fill=LINE, width=2)
