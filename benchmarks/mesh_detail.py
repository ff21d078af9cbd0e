"""Simplified meshes against full ones: triangles, speed, and how far the images agree.

Robots are named or TOML descriptions. Steps of the environment and drawing are timed in turns with
the first robot of the list, so that other load on the machine affects both alike:

    python -m benchmarks.mesh_detail irb120 panda my_arm.toml --json runs/bench/mesh-detail.json
"""

import argparse
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.images import ssim, stray_share
from benchmarks.speed import measure_steps
from knowarm.cli.tables import check_output, print_table, write_json_table
from knowarm.world.config import EnvConfig
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.render import Raycaster
from knowarm.world.render.renderer import MESH_TRIANGLE_PX
from knowarm.world.scene.scene import Scene, load_scene

TARGETS = ("mug", "bottle", "cereal_box")


def random_poses(
    scene: Scene, count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draw poses of all geoms with the joints uniform in their ranges."""
    rng = np.random.default_rng(0)
    data = mujoco.MjData(scene.model)
    positions = np.empty((count, scene.model.ngeom, 3))
    matrices = np.empty((count, scene.model.ngeom, 9))
    for e in range(count):
        data.qpos[scene.qpos_index] = rng.uniform(scene.joint_lower, scene.joint_upper)
        mujoco.mj_kinematics(scene.model, data)
        positions[e], matrices[e] = data.geom_xpos, data.geom_xmat
    return positions, matrices


def compare(robot: str, states: int, side: int) -> dict[str, Any]:
    """Compare images and silhouettes with simplified and with full meshes."""
    scene = load_scene(robot, TARGETS)
    poses = random_poses(scene, states)
    shown: dict[str, Any] = {}
    for name, size in (("full", None), ("simple", MESH_TRIANGLE_PX)):
        caster = Raycaster(
            scene.model,
            scene.camera,
            side,
            side,
            antialiasing=True,
            mesh_triangle_px=size,
        )
        edges = Raycaster(scene.model, scene.camera, side, side, mesh_triangle_px=size)
        geom = edges.trace(*poses).geom
        own = np.array([body > 0 for body in scene.model.geom_bodyid])
        span = caster.scenery.meshes.span[
            np.concatenate([caster.scenery.fixed, caster.scenery.moving])
        ]
        shown[name] = (
            caster.draw(*poses), (geom >= 0) & own[geom], int((span[:, 3] - span[:, 2]).sum())
        )  # fmt: skip
    similar = [
        ssim(a, b) for a, b in zip(shown["full"][0], shown["simple"][0], strict=True)
    ]
    return {
        "robot": Path(robot).stem,
        "triangles": shown["full"][2],
        "simplified": shown["simple"][2],
        "ssim": float(np.mean(similar)),
        "ssim_least": float(np.min(similar)),
        "outline_within_1_px": 1 - stray_share(shown["full"][1], shown["simple"][1]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", nargs="+")
    parser.add_argument("--states", type=int, default=200)
    parser.add_argument("--side", type=int, default=64)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--num-envs", type=int, default=64)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    check_output(arguments.json)
    rows = [
        compare(robot, arguments.states, arguments.side) for robot in arguments.robots
    ]
    envs = [
        ArmVectorEnv(
            EnvConfig(robot=robot, image_size=arguments.side), arguments.num_envs, 1
        )
        for robot in arguments.robots
    ]
    speeds = np.array(
        [
            [measure_steps(env, arguments.seconds).steps_per_cpu_s for env in envs]
            for _ in range(arguments.turns)
        ]
    )
    for row, speed, ratio in zip(
        rows,
        np.median(speeds, axis=0),
        np.median(speeds / speeds[:, :1], axis=0),
        strict=True,
    ):
        row["steps_per_cpu_s"] = round(float(speed))
        row["of_first"] = float(ratio)
    print_table(
        "Simplified meshes", list(rows[0]), [list(row.values()) for row in rows]
    )
    write_json_table(
        arguments.json,
        {
            "rows": rows,
            "config": {
                name: getattr(arguments, name)
                for name in ("states", "side", "turns", "num_envs")
            },
        },
    )


if __name__ == "__main__":
    main()
