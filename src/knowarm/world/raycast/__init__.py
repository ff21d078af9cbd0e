"""Geom poses and colours of a batch go in; pictures come out, without OpenGL."""

from knowarm.world.raycast.raycaster import Raycaster

__all__ = ["Raycaster"]
