"""Images resemble those of MuJoCo's OpenGL renderer, shadows and reflections off."""

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks.images import ssim
from knowarm.world.render import Raycaster
from tests.thorough import combinations
from tests.world.render.opengl_images import NoOpenGL, opengl_images
from tests.world.render.raycast_scenes import (
    CAMERA,
    every_primitive,
    mesh_scene,
    random_states,
    robot_scene,
)

SIDE = 64
STATES = 40

pytestmark = pytest.mark.opengl


def similarity(
    model: mujoco.MjModel, camera: int | str, folder: Path, smooth: bool
) -> float:
    """Mean SSIM between our images and MuJoCo's, both with or both without anti-aliasing."""
    states = random_states(model, STATES, seed=1)
    poses = states.geom_xpos, states.geom_xmat
    ours = Raycaster(model, camera, SIDE, SIDE, antialiasing=smooth).draw(*poses)
    samples = 4 if smooth else 0
    try:
        theirs = opengl_images(
            model, model.camera(camera).id, *poses, SIDE, samples, folder
        )
    except NoOpenGL as reason:
        pytest.skip(str(reason))
    return float(np.mean([ssim(a, b) for a, b in zip(ours, theirs, strict=True)]))


@pytest.mark.parametrize(
    ("robot", "smooth"), combinations(("irb120", "tiago"), (False, True))
)
def test_robots(robot: str, smooth: bool, tmp_path: Path) -> None:
    scene = robot_scene(robot)
    assert similarity(scene.model, scene.camera, tmp_path, smooth) >= 0.95


@pytest.mark.parametrize(
    ("make", "smooth"), combinations((mesh_scene, every_primitive), (False, True))
)
def test_shapes(
    make: Callable[[], mujoco.MjModel], smooth: bool, tmp_path: Path
) -> None:
    assert similarity(make(), CAMERA, tmp_path, smooth) >= 0.95
