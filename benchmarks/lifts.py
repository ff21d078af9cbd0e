"""Lifts from exact grasp poses: every object of the lift test, at random places.

The upper bound of `knowarm evaluate --lift`: the gripper comes straight along the approach
direction, without the steps of the task, and stands in the grasp frame when its fingers close.

python -m benchmarks.lifts --robot irb120 --places 20 --json lifts.json
python -m benchmarks.lifts --robot irb120 --parts --places 25 --json parts.json
python -m benchmarks.lifts --robot irb120 --targets mug,bell --film lifts.png
"""

import argparse
import json
from collections import Counter
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

from knowarm.statistics import wilson
from knowarm.world.objects import PARTS, TARGETS
from knowarm.world.scene.scene import Scene, load_scene, target_places
from knowarm.world.tasks.asked.query.query import CHOOSE_TARGETS
from knowarm.world.tasks.skills.ik import InverseKinematics
from knowarm.world.tasks.skills.lift.probe import (
    LiftTrial,
    build_trial_scene,
    lift,
    plan_lifts,
)

SEED = 7
APPROACH_M, POSES = 0.12, 6  # Way to the grasp frame, and poses on it
SHOWN_S = (0.2, 0.6, 1.6, 2.6, 3.6, 5.6)  # Times of the film's frames


def scene_of(robot: str, target: str) -> Scene:
    """Load the scene of the task in which a target is grasped, with this target alone."""
    area = (
        "purpose"
        if target in PARTS
        else "choose"
        if target in CHOOSE_TARGETS
        else "reach"
    )
    return load_scene(robot, (target,), 0, area)


def straight_paths(scene: Scene, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solve for paths along the approach direction; return (n, POSES + 1, J) and reached (n,)."""
    goal = target_places(scene, position) + scene.grasp_position[0]
    matrix = np.tile(scene.grasp_matrix[0].ravel(), (len(goal), 1))
    home = np.tile(scene.home, (len(goal), 1))
    grasp = InverseKinematics(scene).solve(goal, matrix, home)
    near, joints = InverseKinematics(scene, starts=1), grasp.joints
    path = [joints]
    for distance in np.linspace(0.0, APPROACH_M, POSES + 1)[1:]:
        back = goal - distance * scene.grasp_matrix[0][:, 2]
        joints = near.solve(back, matrix, joints, attempts=1).joints
        path.append(joints)
    return np.stack(path[::-1], axis=1), grasp.within(0.002, 1.0)


def row(robot: str, target: str, places: int) -> dict:
    """Lift one object at random places."""
    scene = scene_of(robot, target)
    described = scene.robot
    half = np.array(described.rectangle_half_size_m)
    offset = np.random.default_rng(SEED).uniform(-1, 1, (places, 2)) * half
    position = np.array(described.rectangle_centre_m) + offset
    paths, reached = straight_paths(scene, position)
    lifts = lift(
        scene, list(paths), np.zeros((places, 1), dtype=np.int64), position[:, None]
    )
    return {
        "robot": robot,
        "target": target,
        "reached": int(reached.sum()),
        "lifted": int((lifts.outcome == "lifted").sum()),
        "places": places,
        "rise_m": float(np.median(lifts.rise)),
        "outcomes": dict(Counter(lifts.outcome.tolist())),
        "excluded": described.cannot_hold.get(target, ""),
    }


def film(robot: str, targets: list[str], path: Path) -> None:
    """Draw a strip per object, lifted in the middle of the rectangle."""
    strips = []
    for target in targets:
        scene = scene_of(robot, target)
        position = np.array(scene.robot.rectangle_centre_m)[None]
        paths, _ = straight_paths(scene, position)
        trial = LiftTrial(build_trial_scene(scene.robot, scene.targets), 1)
        model = trial.simulator.scene.model
        renderer, frames, data = (
            mujoco.Renderer(model, 240, 240),
            [],
            mujoco.MjData(model),
        )
        camera = mujoco.MjvCamera()
        camera.lookat = target_places(scene, position)[0] + scene.grasp_position[0]
        camera.distance, camera.azimuth, camera.elevation = 0.6, 150, -20
        upward = plan_lifts(scene, paths[:, -1])
        for step, _ in enumerate(trial.play(list(paths), upward, position[:, None])):
            if any(abs(step / 10 - at) < 0.01 for at in SHOWN_S):
                trial.simulator.batch.get_data(0, data)
                mujoco.mj_forward(model, data)
                renderer.update_scene(data, camera)
                frames.append(renderer.render().copy())
        renderer.close()
        print(f"{target:14s} {trial.outcome()[0]:8s} rise {trial.rise[0]:.3f} m")
        strips.append(np.concatenate(frames, axis=1))
    Image.fromarray(np.concatenate(strips)).save(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="irb120")
    parser.add_argument("--targets", default=",".join(TARGETS))
    parser.add_argument(
        "--parts", action="store_true", help="the parts of the purpose task"
    )
    parser.add_argument("--places", type=int, default=20)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--film", type=Path)
    given = parser.parse_args()
    targets = list(PARTS) if given.parts else given.targets.split(",")
    if given.film:
        film(given.robot, targets, given.film)
        return
    rows = []
    for target in targets:
        rows.append(row(given.robot, target, given.places))
        print(rows[-1], flush=True)
        if given.json:
            given.json.write_text(json.dumps(rows, indent=1) + "\n")
    counted = [each for each in rows if not each["excluded"]]
    lifted, places = (
        sum(each[name] for each in counted) for name in ("lifted", "places")
    )
    share = wilson(lifted, places)
    print(
        f"{given.robot}: {lifted} of {places} lifted, {100 * share.estimate:.1f} % "
        f"[{100 * share.low:.1f}, {100 * share.high:.1f}], without excluded objects"
    )


if __name__ == "__main__":
    main()
