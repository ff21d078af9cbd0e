"""Speed of the CPU ray caster by scene, batch size, image size and number of geoms.

One thread draws; its CPU time is measured, the best of several repetitions, to reduce the influence
of other load on the machine. Pin it to a core for less variation:

    taskset -c 0 python -m benchmarks.raycast --json runs/bench/raycast.json
"""

import argparse
import time
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from knowarm.cli.tables import check_output, print_table, write_json_table
from knowarm.world.render import Raycaster
from knowarm.world.scene.scene import load_scene

SECONDS = 0.4
"""Least thread time spent per measurement."""

COLUMNS = (
    "scene",
    "environments",
    "side",
    "frames_per_s",
    "frames_per_s_antialiased",
    "times_slower",
)
ROBOTS = ("irb120", "tiago")

Batch = tuple[
    mujoco.MjModel, int, NDArray[np.float64], NDArray[np.float64], NDArray[np.float32]
]
"""Model, camera, geom positions, geom matrices and colours of n states."""


def robot_states(robot: str, count: int) -> Batch:
    """Draw states as in training: joints around home, one target visible, the others hidden."""
    scene = load_scene(robot, ("mug", "bottle", "cereal_box"))
    model, rng = scene.model, np.random.default_rng(0)
    data = mujoco.MjData(model)
    centre, half = (
        np.array(scene.robot.rectangle_centre_m),
        scene.robot.rectangle_half_size_m,
    )
    positions = np.empty((count, model.ngeom, 3))
    matrices = np.empty((count, model.ngeom, 9))
    rgba = np.repeat(
        Raycaster(model, scene.camera, 4, 4).geom_rgba[None], count, axis=0
    )
    for e in range(count):
        angles = scene.home + rng.uniform(-0.5, 0.5, scene.num_joints)
        data.qpos[scene.qpos_index] = np.clip(
            angles, scene.joint_lower, scene.joint_upper
        )
        data.mocap_pos[:, :2] = centre + half * rng.uniform(-1, 1, 2)
        data.mocap_pos[:, 2] = scene.robot.support_height_m
        mujoco.mj_kinematics(model, data)
        positions[e], matrices[e] = data.geom_xpos, data.geom_xmat
        rgba[
            e, (scene.geom_target >= 0) & (scene.geom_target != rng.integers(3)), 3
        ] = 0
    return model, scene.camera, positions, matrices, rgba


def free_states(geoms: str, assets: str, bodies: int, count: int) -> Batch:
    """Draw states of free bodies of one geom each over a floor."""
    body = (
        f'<body><freejoint/><geom {geoms} mass="1" contype="0" conaffinity="0"/></body>'
    )
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco><asset>{assets}</asset><worldbody>
      <camera pos="0 -1.5 1" xyaxes="1 0 0 0 .5 .85" fovy="45"/><geom type="plane" size="5 5 1"/>
      {body * bodies}
    </worldbody></mujoco>""")
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    positions = np.empty((count, model.ngeom, 3))
    matrices = np.empty((count, model.ngeom, 9))
    for e in range(count):
        poses = data.qpos.reshape(bodies, 7)
        poses[:, :3] = rng.uniform([-0.5, -0.5, 0], [0.5, 0.5, 0.6], (bodies, 3))
        poses[:, 3:] = rng.normal(size=(bodies, 4))
        mujoco.mj_kinematics(model, data)
        positions[e], matrices[e] = data.geom_xpos, data.geom_xmat
    return (
        model,
        0,
        positions,
        matrices,
        np.repeat(model.geom_rgba[None], count, axis=0),
    )


def ball(subdivisions: int) -> str:
    """Return the MJCF asset of a ball of 2 n (n - 1) triangles, n = 4 x ``subdivisions``."""
    n = 4 * subdivisions
    turn, tilt = np.arange(n) * 2 * np.pi / n, np.arange(1, n) * np.pi / n
    ring = np.stack(
        [
            np.outer(np.sin(tilt), np.cos(turn)),
            np.outer(np.sin(tilt), np.sin(turn)),
            np.outer(np.cos(tilt), np.ones(n)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    vertices = np.concatenate([ring, [[0, 0, 1], [0, 0, -1]]]) * 0.15
    north, south = len(ring), len(ring) + 1
    faces = []
    for k in range(n):
        following = (k + 1) % n
        faces += [
            (north, k, following),
            (south, (n - 2) * n + following, (n - 2) * n + k),
        ]
        for j in range(n - 2):
            a, b = j * n + k, j * n + following
            faces += [(a, a + n, b + n), (a, b + n, b)]
    numbers = " ".join(f"{x:.6f}" for x in vertices.ravel())
    return f'<mesh name="ball" vertex="{numbers}" face="{" ".join(map(str, np.ravel(faces)))}"/>'


def frames_per_s(batch: Batch, side: int, antialiasing: bool) -> float:
    """Measure frames per second of CPU time on one thread, the best of several calls."""
    model, camera, positions, matrices, rgba = batch
    caster = Raycaster(model, camera, side, side, antialiasing=antialiasing)
    caster.draw(positions, matrices, rgba)  # compiles
    best, spent = np.inf, 0.0
    while spent < SECONDS:
        start = time.thread_time()
        caster.draw(positions, matrices, rgba)
        taken = time.thread_time() - start
        best, spent = min(best, taken), spent + taken
    return len(positions) / best


def row(name: str, batch: Batch, side: int) -> dict[str, str | int | float]:
    """Measure one row of the table."""
    plain, smooth = (frames_per_s(batch, side, flag) for flag in (False, True))
    values = (name, len(batch[2]), side, round(plain), round(smooth), plain / smooth)
    return dict(zip(COLUMNS, values, strict=True))


def measure() -> list[dict[str, str | int | float]]:
    """Measure all rows of the table."""
    rows = [row(robot, robot_states(robot, 256), 64) for robot in ROBOTS]
    rows += [
        row("irb120", robot_states("irb120", count), 64) for count in (1, 16, 4096)
    ]
    rows += [row("irb120", robot_states("irb120", 64), side) for side in (32, 128, 256)]
    for bodies in (1, 10, 30, 100):
        batch = free_states('type="box" size=".05 .08 .03"', "", bodies, 64)
        rows.append(row(f"{bodies} boxes", batch, 64))
    for subdivisions in (4, 12, 40):
        batch = free_states('type="mesh" mesh="ball"', ball(subdivisions), 5, 16)
        triangles = 5 * int(batch[0].mesh_facenum[0])
        rows.append(row(f"5 meshes, {triangles:,} triangles", batch, 64))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--json", type=Path, default=None, help="file to write the table to"
    )
    arguments = parser.parse_args()
    check_output(arguments.json)
    rows = measure()
    print_table(
        "Ray caster, one thread", COLUMNS, [list(line.values()) for line in rows]
    )
    write_json_table(arguments.json, {"rows": rows})


if __name__ == "__main__":
    main()
