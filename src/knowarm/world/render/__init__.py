"""Renderers: RGB images of batches of MuJoCo states, by ray casting or by OpenGL."""

from knowarm.world.render.cpu import Raycaster

__all__ = ["Raycaster"]
