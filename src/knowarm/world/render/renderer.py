"""Renderer interface, and the choice of renderer.

Two implementations: the ray caster (``cpu.Raycaster``, compiled by Numba), and MuJoCo's OpenGL
renderer as the reference (``opengl.OpenGLRenderer``).
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from knowarm.cores import available_cores
from knowarm.world.config import EnvConfig
from knowarm.world.render.cpu import Raycaster
from knowarm.world.scene.scene import Scene


class Renderer(Protocol):
    """Draws the environments of a batch from the poses of their geoms."""

    def draw(
        self,
        geom_position: NDArray[np.float64],
        geom_matrix: NDArray[np.float64],
        geom_rgba: NDArray[np.float32],
        views: NDArray[np.float32] | None = None,
        lamps: NDArray[np.float32] | None = None,
    ) -> NDArray[np.uint8]:
        """Draw n images.

        Args:
            geom_position: (n, G, 3) [m], world.
            geom_matrix: (n, G, 9), row-major rotation from geom to world.
            geom_rgba: (n, G, 4) in 0..1; alpha 0 hides a geom.
            views: position [m] and row-major rotation of each camera, (n, 12); None for the
                model's.
            lamps: sum of ambient colours, diffuse colours of headlight and directional light, and
                the unit vector towards the latter, (n, 4, 3); None for the model's.

        Returns:
            (n, H, W, 3) uint8 RGB, a new array.
        """


MESH_TRIANGLE_PX = 0.71  # Size of the triangles of simplified meshes [px]


def make_renderer(scene: Scene, config: EnvConfig, size: int, num_threads: int = 0) -> Renderer:
    """Construct the renderer that a config names, for square images of ``size`` pixels.

    ``num_threads`` share a batch, 0 for one per core; OpenGL uses one.
    """
    if config.renderer == "opengl":
        from knowarm.world.render.opengl import OpenGLRenderer

        return OpenGLRenderer(scene, size)
    return Raycaster(
        scene.model,
        scene.camera,
        size,
        size,
        antialiasing=config.antialiasing,
        num_threads=num_threads or available_cores(),
        mesh_triangle_px=MESH_TRIANGLE_PX if config.mesh_detail == "pixels" else None,
    )
