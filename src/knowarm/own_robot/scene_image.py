"""Image of a robot's scene: the start pose, the rectangle of the targets, what the policy sees."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image, ImageDraw

from knowarm.reading import replacing
from knowarm.world.config import EnvConfig
from knowarm.world.render.renderer import make_renderer
from knowarm.world.scene.appearance import TargetColours
from knowarm.world.scene.scene import Scene, project, target_places

SIDE = 512  # Side of each of the two images [px]
LINE = (255, 210, 60)  # Colour of the rectangle and of the gripper's approach
APPROACH_M = 0.1  # Length of the line that shows the gripper's approach [m]


def write_scene_image(scene: Scene, config: EnvConfig, path: Path) -> None:
    """Draw the arm at its start with the targets at corners of the rectangle, and write a PNG."""
    robot, model = scene.robot, scene.model
    data = scene.at(scene.home)
    centre, half = np.array(robot.rectangle_centre_m), np.array(robot.rectangle_half_size_m)
    corners = target_places(scene, centre + half * [(-1, -1), (-1, 1), (1, 1), (1, -1)])
    for k, mocap in enumerate(scene.target_mocap):
        data.mocap_pos[mocap] = corners[k % 4]
    mujoco.mj_kinematics(model, data)
    poses = data.geom_xpos[None], data.geom_xmat[None]
    shown = np.arange(len(scene.targets))[None]
    colours = TargetColours(scene)(shown, np.zeros_like(shown))
    small = make_renderer(scene, config, config.image_size, 1).draw(*poses, colours)[0]
    # One image is drawn faster with full meshes than they are simplified.
    full = replace(config, mesh_detail="full")
    large = Image.fromarray(make_renderer(scene, full, SIDE, 1).draw(*poses, colours)[0])
    pen = ImageDraw.Draw(large)
    tip = data.site_xpos[scene.tcp_site]
    ahead = tip + APPROACH_M * data.site_xmat[scene.tcp_site].reshape(3, 3)[:, 2]
    for points in (np.concatenate([corners, corners[:1]]), np.stack([tip, ahead])):
        seen = (project(scene, points) * [1, -1] + 1) * SIDE / 2
        if np.isfinite(seen).all():
            pen.line([tuple(point) for point in seen.tolist()], fill=LINE, width=2)
    both = Image.new("RGB", (2 * SIDE, SIDE))
    both.paste(large, (0, 0))
    both.paste(Image.fromarray(small).resize((SIDE, SIDE), Image.Resampling.NEAREST), (SIDE, 0))
    with replacing(path) as temporary:
        both.save(temporary)
