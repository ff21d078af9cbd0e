"""MuJoCo models and random states to draw in the ray caster's tests."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from knowarm.world.batch import make_batch
from knowarm.world.scene.scene import Scene, load_scene

CAMERA = "eye"

SHAPES = {
    "plane": ".3 .2 .1",
    "sphere": ".12",
    "capsule": ".05 .15",
    "ellipsoid": ".08 .15 .05",
    "cylinder": ".09 .12",
    "box": ".1 .06 .14",
}


def every_primitive() -> mujoco.MjModel:
    """A floor, a table and three free copies of every primitive, before a tilted camera."""
    bodies = ""
    for k, (kind, size) in enumerate(SHAPES.items()):
        for i in range(3):
            place = f"{0.3 * (k % 3) - 0.3} {0.3 * i - 0.3} {0.3 + 0.3 * (k // 3)}"
            colour = f"{0.2 + 0.1 * k} {0.9 - 0.2 * i} .4 1"
            # A plane cannot have a free joint: it belongs to the world or to a mocap body.
            mocap, joint = (
                ('mocap="true"', "") if kind == "plane" else ("", "<freejoint/>")
            )
            bodies += f"""<body name="{kind}{i}" pos="{place}" {mocap}>{joint}
                <geom type="{kind}" size="{size}" rgba="{colour}" contype="0" conaffinity="0"
                mass="1"/></body>"""
    return mujoco.MjModel.from_xml_string(f"""
    <mujoco>
      <visual><headlight ambient=".3 .3 .3" diffuse=".4 .4 .4" specular="0 0 0"/></visual>
      <worldbody>
        <light type="directional" dir="-.3 .4 -.9" diffuse=".4 .4 .3" specular="0 0 0"/>
        <camera name="{CAMERA}" pos="1.3 -1.1 1.2" xyaxes=".65 .76 .02 -.36 .32 .87" fovy="50"/>
        <geom type="plane" size="0 0 .1" rgba=".6 .6 .6 1"/>
        <geom type="box" size=".4 .3 .05" pos="0 0 .05" rgba=".5 .5 .7 1"/>
        {bodies}
      </worldbody>
    </mujoco>""")


def torus(
    rings: int = 16, sides: int = 10
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A torus of radius .15 m and thickness .05 m: vertices (V, 3) and triangles (T, 3)."""
    u, v = np.meshgrid(
        np.arange(rings) * 2 * np.pi / rings,
        np.arange(sides) * 2 * np.pi / sides,
        indexing="ij",
    )
    out = 0.15 + 0.05 * np.cos(v)
    vertices = np.stack([out * np.cos(u), out * np.sin(u), 0.05 * np.sin(v)], axis=-1)
    i, j = (
        grid.ravel()
        for grid in np.meshgrid(np.arange(rings), np.arange(sides), indexing="ij")
    )
    a, b = i * sides + j, (i + 1) % rings * sides + j
    c, d = (i + 1) % rings * sides + (j + 1) % sides, i * sides + (j + 1) % sides
    triangles = np.concatenate(
        [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
    )
    return vertices.reshape(-1, 3), triangles


def mesh_scene(rings: int = 16, sides: int = 10) -> mujoco.MjModel:
    """Free tori, tetrahedra and balls over a floor and a mesh that stands still."""
    vertices, triangles = torus(rings, sides)
    numbers = " ".join(f"{x:.6f}" for x in vertices.ravel())
    faces = " ".join(map(str, triangles.ravel()))
    bodies = "".join(
        f"""<body pos="{0.3 * (k % 3) - 0.3} {0.25 * (k // 3) - 0.3} {0.3 + 0.1 * (k % 2)}">
        <freejoint/><geom {what} rgba="{0.2 + 0.09 * k} {1 - 0.1 * k} .5 1" mass="1"
        contype="0" conaffinity="0"/></body>"""
        for k, what in enumerate(
            [
                'type="mesh" mesh="torus"',
                'type="mesh" mesh="point"',
                'type="sphere" size=".1"',
            ]
            * 3
        )
    )
    return mujoco.MjModel.from_xml_string(f"""
    <mujoco>
      <visual><headlight ambient=".3 .3 .3" diffuse=".4 .4 .4" specular="0 0 0"/></visual>
      <asset>
        <mesh name="torus" vertex="{numbers}" face="{faces}"/>
        <mesh name="point" vertex="0 0 0 .2 0 0 0 .2 0 .05 .05 .3"/>
        <mesh name="large" vertex="{numbers}" face="{faces}" scale="2 2 2"/>
      </asset>
      <worldbody>
        <light type="directional" dir="-.3 .4 -.9" diffuse=".4 .4 .3" specular="0 0 0"/>
        <camera name="{CAMERA}" pos="1.3 -1.1 1.2" xyaxes=".65 .76 .02 -.36 .32 .87" fovy="50"/>
        <geom type="plane" size="0 0 .1" rgba=".6 .6 .6 1"/>
        <geom type="mesh" mesh="large" pos="0 0 .1" rgba=".5 .5 .7 1"/>
        {bodies}
      </worldbody>
    </mujoco>""")


@dataclass(frozen=True)
class States:
    """n states of a model: its batch, and geom poses (n, G, 3) and (n, G, 9)."""

    model: mujoco.MjModel
    batch: Any
    geom_xpos: NDArray[np.float64]
    geom_xmat: NDArray[np.float64]


def random_states(model: mujoco.MjModel, count: int, seed: int) -> States:
    """Draw states with joints and mocap bodies near the model's reference state."""
    rng = np.random.default_rng(seed)
    batch = make_batch(model, count, 2)
    positions, matrices = batch.bind("geom_xpos"), batch.bind("geom_xmat")
    qpos = batch.bind("qpos")
    qpos[:] += rng.uniform(-0.4, 0.4, qpos.shape)
    if model.nmocap:
        place, turn = batch.bind("mocap_pos"), batch.bind("mocap_quat")
        place[:] += rng.uniform(-0.2, 0.2, place.shape)
        turn[:] += rng.uniform(-0.4, 0.4, turn.shape)
    batch.forward(stage=mujoco.mjtStage.mjSTAGE_POS)
    return States(
        model, batch, positions.reshape(count, -1, 3), matrices.reshape(count, -1, 9)
    )


def robot_scene(robot: str) -> Scene:
    """The scene of a shipped robot with the paper's targets."""
    return load_scene(robot, ("mug", "bottle", "cereal_box"))


def camera_rays(
    model: mujoco.MjModel, camera: int | str, width: int, height: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The eye (3,) and unit directions (H * W, 3) through the pixels' centres, world."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    eye = data.camera(camera)
    pixel = 2 * np.tan(np.radians(model.cam_fovy[eye.id]) / 2) / height
    x = (np.arange(width) + 0.5 - width / 2) * pixel
    y = (height / 2 - np.arange(height) - 0.5) * pixel
    rays = np.stack(
        [*np.meshgrid(x, y), np.full((height, width), -1.0)], axis=-1
    ).reshape(-1, 3)
    rays = rays @ eye.xmat.reshape(3, 3).T
    return eye.xpos.copy(), rays / np.linalg.norm(rays, axis=1, keepdims=True)
