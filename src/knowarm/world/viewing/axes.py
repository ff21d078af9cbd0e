"""Grasp frame, gripper frame and the sphere of success, drawn over an image of the scene."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.scene.scene import project

LENGTH_M = 0.08  # Length of an axis [m]
_SPHERE_POINTS = 64
_COLOURS = ((214, 39, 40), (44, 160, 44), (31, 119, 180))  # of the x, y and z axis
_SPHERE = (255, 255, 255)


def draw_axes(env: ArmVectorEnv, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Draw both frames of environment 0 over its image (H, H, 3) uint8: a new image.

    The axes x, y and z are red, green and blue, thick for the goal and thin for the gripper, and
    are drawn over what hides them. The circle is the outline of the sphere around the goal in
    which the gripper's distance counts as success.
    """
    running = env.running
    picture = Image.fromarray(image)
    draw = ImageDraw.Draw(picture)
    view = None if running.shown.views is None else running.shown.views[0]

    def line(points: NDArray[Any], colour: tuple[int, int, int], width: int) -> None:
        pixels = (1 + project(env.scene, points, view) * (1, -1)) * len(image) / 2
        if np.isfinite(pixels).all():  # in front of the camera
            draw.line([(x, y) for x, y in pixels], colour, width)

    goal, gripper = running.goal_position[0], running.simulator.tcp_position[0]
    towards = goal - (env.scene.camera_position if view is None else view[:3])
    right, up = np.linalg.svd(towards[None])[2][1:]  # span the plane across the line of sight
    turn = np.linspace(0, 2 * np.pi, _SPHERE_POINTS)[:, None]
    circle = np.cos(turn) * right + np.sin(turn) * up
    line(goal + running.limits[0] * circle, _SPHERE, 2)
    frames = ((goal, running.goal_matrix, 4), (gripper, running.simulator.tcp_matrix, 2))
    for origin, matrix, width in frames:
        for axis, colour in zip(matrix[0].reshape(3, 3).T, _COLOURS, strict=True):
            line(np.stack([origin, origin + LENGTH_M * axis]), colour, width)
    return np.asarray(picture)
