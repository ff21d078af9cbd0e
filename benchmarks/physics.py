"""Convergence of lifting in the physics' time step, and overlaps of the arm's links in reaching.

python -m benchmarks.physics --episodes 40 --json physics.json
"""

import argparse
import copy
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from knowarm.statistics import wilson
from knowarm.world.agents.play import play
from knowarm.world.agents.scripted import OracleAgent
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.robots import ROBOTS
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.skills.lift.lift import Lift
from knowarm.world.tasks.skills.lift.model import LiftScene, build_lift_scene
from knowarm.world.tasks.task import Task

SEED = 7
TIMESTEPS_MS = (1.0, 2.0, 4.0, 10.0)
OVERLAP_M = 0.005
"""Depth from which two links overlap."""


@dataclass(frozen=True, kw_only=True)
class FineLift(Lift):
    """The lifting task with another time step where the fingers may grip."""

    def at(self, timestep_ms: float) -> "FineLift":
        """Return the task with a time step [ms]."""

        def build_scene(robot: Any, targets: Any, distractors: int) -> LiftScene:
            return build_lift_scene(robot, targets, distractors, timestep_ms / 1000)

        object.__setattr__(self, "build_scene", build_scene)
        return self


def lift_row(robot: str, timestep_ms: float, episodes: int) -> dict[str, Any]:
    """Play the oracle of the lifting task."""
    env = ArmVectorEnv(
        EnvConfig(
            robot=robot, task=Task(skill=FineLift().at(timestep_ms)), image_size=8
        ),
        episodes,
    )
    assert env.scene.model.opt.timestep == timestep_ms / 1000
    played = play(
        OracleAgent(env), env, evaluation_episodes(env.config, episodes, SEED)
    )
    share = wilson(int(played.success.sum()), episodes)
    return {
        "robot": robot,
        "timestep_ms": timestep_ms,
        "episodes": episodes,
        "lifted": [share.estimate, share.low, share.high],
        "steps_mean": float(played.length.mean()),
    }


def overlap_row(robot: str, episodes: int) -> dict[str, Any]:
    """Count the oracle's reaching episodes in which links of the arm overlap."""
    env = ArmVectorEnv(EnvConfig(robot=robot, image_size=8), episodes)
    played = play(
        OracleAgent(env), env, evaluation_episodes(env.config, episodes, SEED)
    )
    depth = overlaps(env.scene, played.steps.joint_positions)
    deep = np.unique(played.steps.episode[depth > OVERLAP_M])
    return {
        "robot": robot,
        "episodes": episodes,
        "overlapping": len(deep),
        "deepest_m": float(depth.max()),
    }


def overlaps(scene: Scene, joints: np.ndarray) -> np.ndarray:
    """Return how deep links that are apart in the home pose overlap, (n,) [m], of angles (n, J)."""
    model = copy.copy(scene.model)
    of_robot = [
        model.body(model.geom_bodyid[i]).name.startswith("robot/")
        for i in range(model.ngeom)
    ]
    model.geom_contype[:] = model.geom_conaffinity[:] = np.array(of_robot, dtype=int)
    model.body_contype[:] = model.body_conaffinity[:] = (
        1  # what the broad phase looks at
    )
    data = mujoco.MjData(model)

    def depths(angles: np.ndarray) -> dict[tuple[int, int], float]:
        data.qpos[scene.qpos_index] = angles
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        found: dict[tuple[int, int], float] = {}
        for i in range(data.ncon):
            one, other = sorted(model.geom_bodyid[data.contact.geom[i]].tolist())
            found[one, other] = max(
                found.get((one, other), 0.0), -float(data.contact.dist[i])
            )
        return found

    touching = depths(scene.home).keys()
    return np.array(
        [
            max(
                (d for pair, d in depths(each).items() if pair not in touching),
                default=0.0,
            )
            for each in joints
        ]
    )


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [f"| {' | '.join(line)} |" for line in (columns, *rows)]
    return "\n".join([title, "", lines[0], "|---" * len(columns) + "|", *lines[1:], ""])


def main() -> None:
    """Measure, print and store."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=40)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    lifts = [
        lift_row(robot, ms, given.episodes) for robot in ROBOTS for ms in TIMESTEPS_MS
    ]
    links = [overlap_row(robot, given.episodes) for robot in ROBOTS]
    cells = []
    for row in lifts:
        share, low, high = (100 * value for value in row["lifted"])
        lifted = f"{share:.1f} [{low:.1f}, {high:.1f}]"
        cells.append(
            [
                row["robot"],
                f"{row['timestep_ms']:g} ms",
                lifted,
                f"{row['steps_mean']:.1f}",
            ]
        )
    print(
        table("Lifting, oracle", ["robot", "time step", "lifted [%]", "steps"], cells)
    )
    cells = [
        [
            row["robot"],
            f"{row['overlapping']} of {row['episodes']}",
            f"{1000 * row['deepest_m']:.1f} mm",
        ]
        for row in links
    ]
    print(
        table(
            "Links that overlap by 5 mm, reaching, oracle",
            ["robot", "episodes", "deepest"],
            cells,
        )
    )
    if given.json:
        given.json.write_text(
            json.dumps({"lifts": lifts, "overlaps": links}, indent=1) + "\n"
        )


if __name__ == "__main__":
    main()
