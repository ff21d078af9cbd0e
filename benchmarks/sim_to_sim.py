"""Transfer of policies from the ray caster to MuJoCo's OpenGL renderer: lamp, shadows, camera.

python -m benchmarks.sim_to_sim RUN... [--episodes 200] [--json FILE]

Runs of the same folder are training seeds of one row. Light and camera are drawn per episode as in
visual randomization. Needs OpenGL: MUJOCO_GL=egl or osmesa.
"""

import argparse
import copy
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from knowarm.arrays import Floats
from knowarm.experiment.load import load_agent
from knowarm.statistics import bootstrap
from knowarm.world.agents.play import play
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.render.renderer import OpenGLRenderer
from knowarm.world.scene.appearance import VisualRandomization
from knowarm.world.scene.scene import Scene

# Each axis varies by up to 1 cm and 1 degree, which are also the root mean squares over three axes.
CAMERA = {"camera_shift_m": 0.01, "camera_turn_deg": 1.0}
LIGHT = {"light": 0.3, "light_angle_deg": 20.0}
KINDS: dict[str, tuple[bool, bool, dict[str, Any]]] = {
    "ray caster": (False, False, {}),
    "ray caster, camera": (False, False, CAMERA),
    "OpenGL": (True, False, {}),
    "OpenGL, lamp": (True, True, LIGHT),
    "OpenGL, lamp, camera": (True, True, LIGHT | CAMERA),
}
"""Whether OpenGL draws, whether a lamp casts shadows, and what varies, by row of the table."""
LAMP_M = 2.5
"""Distance of the lamp from the middle of the rectangle [m]."""


class LampRenderer(OpenGLRenderer):
    """MuJoCo's renderer with a lamp in the direction of the sun, which casts shadows.

    MuJoCo speckles those of directional lights.
    """

    def __init__(self, scene: Scene, size: int) -> None:
        model = copy.copy(scene.model)
        model.light_type[0] = mujoco.mjtLightType.mjLIGHT_SPOT
        model.light_cutoff[0], model.light_exponent[0] = 60, 0
        model.light_castshadow[0] = True
        quality = model.vis.quality
        quality.shadowsize, quality.numslices, quality.numstacks = 512, 16, 16
        super().__init__(replace(scene, model=model), size)
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = True
        self._middle = np.array(
            [*scene.robot.rectangle_centre_m, scene.robot.support_height_m]
        )

    def draw(
        self,
        geom_position: Floats,
        geom_matrix: Floats,
        geom_rgba: NDArray[np.float32],
        views: NDArray[np.float32] | None = None,
        lamps: NDArray[np.float32] | None = None,
    ) -> NDArray[np.uint8]:
        """Draw n images; see ``Renderer.draw``."""
        images = []
        for i in range(len(geom_position)):
            direction = self._data.light_xdir[0] if lamps is None else -lamps[i, 3]
            self._data.light_xpos[0] = self._middle - LAMP_M * direction
            looks = (
                None if each is None else each[i : i + 1] for each in (views, lamps)
            )
            poses = geom_position[i : i + 1], geom_matrix[i : i + 1]
            images.append(super().draw(*poses, geom_rgba[i : i + 1], *looks)[0])
        return np.stack(images)


def success(run: Path, kind: str, episodes: int, seed: int) -> float:
    """Play a run's policy on images of a kind; return the share of successes."""
    trained = load_agent(run)
    opengl, lamp, varied = KINDS[kind]
    config = replace(trained.config.env, randomization=VisualRandomization(**varied))
    env = ArmVectorEnv(config, min(episodes, 100), num_threads=1)
    if opengl:
        kind_of = LampRenderer if lamp else OpenGLRenderer
        env.renderer = kind_of(env.scene, config.image_size)
    result = play(trained.agent, env, evaluation_episodes(config, episodes, seed))
    env.close()
    return float(result.success.mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for folder in dict.fromkeys(run.parent for run in given.runs):
        runs = [run for run in given.runs if run.parent == folder]
        for kind in KINDS:
            shares = [success(run, kind, given.episodes, given.seed) for run in runs]
            found = bootstrap(np.array(shares))
            interval = {"mean": found.estimate, "low": found.low, "high": found.high}
            rows.append(
                {"runs": str(folder), "images": kind, "seeds": shares, **interval}
            )
            mean, low, high = (100 * each for each in interval.values())
            each = ", ".join(f"{100 * share:.1f}" for share in shares)
            print(
                f"| {folder} | {kind} | {mean:.1f} [{low:.1f}, {high:.1f}] | {each} |",
                flush=True,
            )
    if given.json:
        given.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
