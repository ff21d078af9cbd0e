"""Geom poses and colours of a batch go in; images come out, without OpenGL."""

from knowarm.world.render.raycaster import Raycaster

__all__ = ["Raycaster"]
