"""Our pictures beside those of MuJoCo's OpenGL renderer, shadows and reflections off."""

import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from raycast_scenes import CAMERA, States, every_primitive, random_states, robot_scene
from scipy.ndimage import gaussian_filter

from knowarm.world.raycast import Raycaster

SIDE = 64
STATES = 40

pytestmark = pytest.mark.opengl


def ssim(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Structural similarity (Wang et al. 2004), Gaussian window of 1.5 pixels, a channel each."""
    values = []
    for channel in range(3):
        x, y = (image[..., channel].astype(np.float64) for image in (a, b))
        mean_x, mean_y = gaussian_filter(x, 1.5), gaussian_filter(y, 1.5)
        var_x = gaussian_filter(x * x, 1.5) - mean_x**2
        var_y = gaussian_filter(y * y, 1.5) - mean_y**2
        cov = gaussian_filter(x * y, 1.5) - mean_x * mean_y
        c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
        score = (2 * mean_x * mean_y + c1) * (2 * cov + c2)
        values.append((score / ((mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2))).mean())
    return float(np.mean(values))


@pytest.fixture(scope="module")
def opengl() -> None:
    """Software OpenGL, or the reason why there is none."""
    # MuJoCo aborts the interpreter where a context cannot be made, so another one tries first.
    check = "import mujoco; mujoco.Renderer(mujoco.MjModel.from_xml_string('<mujoco/>'), 8, 8)"
    os.environ.setdefault("MUJOCO_GL", "egl")
    tried = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True)
    if tried.returncode:
        last = (tried.stderr.strip().splitlines() or ["no message"])[-1]
        pytest.skip(
            f"no OpenGL for MuJoCo's renderer (MUJOCO_GL={os.environ['MUJOCO_GL']}): {last}"
        )


def mujoco_pictures(states: States, camera: int | str, samples: int) -> NDArray[np.uint8]:
    """Draw all states with MuJoCo's renderer, with or without multisampling."""
    model, batch = states.model, states.batch
    before = model.vis.quality.offsamples
    model.vis.quality.offsamples = samples
    data = mujoco.MjData(model)
    pictures = []
    with mujoco.Renderer(model, SIDE, SIDE) as renderer:
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        for e in range(batch.nsim):
            batch.get_data(e, data)
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera)
            pictures.append(renderer.render())
    model.vis.quality.offsamples = before
    return np.array(pictures)


def similarity(states: States, camera: int | str) -> float:
    ours = Raycaster(states.model, camera, SIDE, SIDE).render(states.geom_xpos, states.geom_xmat)
    theirs = mujoco_pictures(states, camera, samples=0)
    return float(np.mean([ssim(a, b) for a, b in zip(ours, theirs, strict=True)]))


@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize("robot", ["irb120", "tiago"])
def test_robots(robot: str) -> None:
    scene = robot_scene(robot)
    assert similarity(random_states(scene.model, STATES, seed=1), scene.camera) >= 0.95


@pytest.mark.usefixtures("opengl")
def test_every_primitive() -> None:
    assert similarity(random_states(every_primitive(), STATES, seed=2), CAMERA) >= 0.95
