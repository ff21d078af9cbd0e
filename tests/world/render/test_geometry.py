"""Geom ids, distances and normals of the ray caster equal those of MuJoCo's rays."""

import mujoco
import numpy as np
import pytest

from knowarm.world.render import Raycaster
from tests.thorough import thorough
from tests.world.render.normals import pixel_normals
from tests.world.render.raycast_scenes import (
    CAMERA,
    States,
    camera_rays,
    every_primitive,
    mesh_scene,
    random_states,
    robot_scene,
)

SIDE = 64


def agreement(
    states: States, camera: int | str, width: int = SIDE, height: int = SIDE
) -> float:
    """Share of pixels in which geom id, distance (1e-4) and normal (1e-3) are MuJoCo's."""
    if not hasattr(states.batch, "ray"):
        pytest.skip("MuJoCo before 3.17 casts no rays for a batch")
    eye, rays = camera_rays(states.model, camera, width, height)
    distance, geom, normal = states.batch.ray(eye, rays, normal=True)
    caster, poses = (
        Raycaster(states.model, camera, width, height),
        (states.geom_xpos, states.geom_xmat),
    )
    ours, count = caster.trace(*poses), len(geom)
    normals = pixel_normals(caster, ours.geom, *poses)
    same = ours.geom.reshape(count, -1) == geom
    same &= np.abs(ours.distance.reshape(count, -1) - distance) <= 1e-4 * np.maximum(
        distance, 1
    )
    same &= np.abs(normals.reshape(count, -1, 3) - normal).max(axis=-1) <= 1e-3
    assert (geom >= 0).any()
    return float(same.mean())


@pytest.mark.parametrize("robot", ["irb120", "tiago"])
def test_robots(robot: str) -> None:
    scene = robot_scene(robot)
    assert (
        agreement(random_states(scene.model, thorough(15, 40), seed=1), scene.camera)
        >= 0.999
    )


def test_every_primitive() -> None:
    states = random_states(every_primitive(), 200, seed=2)
    assert agreement(states, CAMERA) >= 0.999


def test_meshes() -> None:
    states = random_states(mesh_scene(), 200, seed=5)
    assert agreement(states, CAMERA) >= 0.999


def test_mesh_that_reaches_behind_the_eye() -> None:
    model = mesh_scene()
    model.cam_pos[0] = [0.25, 0.1, 0.2]
    assert agreement(random_states(model, 20, seed=6), CAMERA) >= 0.999


def test_image_that_is_not_square() -> None:
    states = random_states(every_primitive(), 5, seed=3)
    assert agreement(states, CAMERA, width=83, height=37) >= 0.999


@pytest.mark.parametrize("kind", ["sphere", "capsule", "ellipsoid", "cylinder", "box"])
def test_eye_inside_a_solid_sees_its_far_side(kind: str) -> None:
    size = {"sphere": "1", "capsule": ".6 .7", "ellipsoid": ".5 .8 .6"}.get(
        kind, ".7 .8 .9"
    )
    size = " ".join(size.split()[:2]) if kind == "cylinder" else size
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco><worldbody><camera name="{CAMERA}" xyaxes="1 .2 .1 -.2 1 .3" fovy="90"/>
      <body><freejoint/><geom type="{kind}" size="{size}" pos=".1 .05 .1"/></body>
    </worldbody></mujoco>""")
    states = random_states(model, 20, seed=4)
    assert agreement(states, CAMERA) >= 0.999


@pytest.mark.parametrize("kind", ["capsule", "cylinder", "box"])
def test_ray_along_the_axis(kind: str) -> None:
    """The ray of the central pixel of an odd-sized image is exactly along the geom's axis."""
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco><worldbody><camera name="{CAMERA}" pos="0 0 2"/>
      <geom type="{kind}" size=".2 .3 {"" if kind != "box" else ".4"}"/>
    </worldbody></mujoco>""")
    caster = Raycaster(model, CAMERA, 5, 5)
    traced = caster.trace(*poses(model))
    normal = pixel_normals(caster, traced.geom, *poses(model))
    top = {"capsule": 0.5, "cylinder": 0.3, "box": 0.4}[kind]
    assert traced.geom[0, 2, 2] == 0
    assert traced.distance[0, 2, 2] == pytest.approx(2 - top, abs=1e-5)
    np.testing.assert_allclose(normal[0, 2, 2], [0, 0, 1], atol=1e-5)


def poses(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data.geom_xpos[None], data.geom_xmat[None]
