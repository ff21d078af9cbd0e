"""Checks of the objects of a task with several: reach, visibility, differences in the image."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knowarm.check import Check
from knowarm.errors import UserError
from knowarm.own_robot.pixels import different_pixels
from knowarm.own_robot.robot_check import check_reach, check_visible
from knowarm.questions import object_of
from knowarm.world.agents import OracleAgent
from knowarm.world.agents.play import play
from knowarm.world.backend import MujocoSimulator
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.render.renderer import make_renderer
from knowarm.world.robots import find_robot
from knowarm.world.scene.appearance import TargetColours, resting_colours
from knowarm.world.scene.scene import Scene, load_scene, target_places
from knowarm.world.tasks import find_task
from knowarm.world.tasks.skills.ik import InverseKinematics

PLACES = 4  # Positions per side of the grid over the rectangle at which objects are checked
EPISODES, MIN_ORACLE = 60, 0.8  # That the oracle plays, and its least success
MIN_DIFFERENT = 6
"""Least number of pixels in which two objects of one colour differ, or one in two colours."""
Images = dict[str, NDArray[np.int16]]
"""Images of an object at P places, (P, H, W, 3), by the name of its colour."""


def check_objects(
    robot: str, task: str, targets: Sequence[str] = (), **options: Any
) -> list[Check]:
    """Check objects, or those of the task, in the area of a robot in which the task places them.

    Options are other fields of ``EnvConfig``. Return the results in order; only the first if the
    scene cannot be built.
    """
    try:
        config = EnvConfig(robot=robot, task=find_task(task), targets=tuple(targets), **options)
        scene = load_scene(config.robot, config.targets, area=_area(config))
    except UserError as error:
        return [Check("scene", False, str(error), "Correct what that line names.")]
    # From border to border of the rectangle, (P, 2) [m].
    line, centre = np.linspace(-1, 1, PLACES), scene.robot.rectangle_centre_m
    signed = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    places = np.asarray(centre + signed * scene.robot.rectangle_half_size_m)
    found = f"{len(config.targets)} targets, {config.task.visible} per episode"
    checks = [Check("scene", True, found)]
    checks += [_check_reach(scene, config, k, places) for k in range(len(config.targets))]
    images, empty = _images(scene, config, places)
    remedy = "enlarge the object or move the camera nearer."
    checks += [
        check_visible(name, np.stack([*shown.values()]), empty, remedy) for name, shown in images
    ]
    checks += _check_differences(images)
    return [*checks, *([_check_oracle(config)] if all(check.ok for check in checks) else [])]


def _area(config: EnvConfig) -> str:
    """Return the name of the robot's area in which the task places objects."""
    return config.task.area_of(find_robot(config.robot))


def oracle_success(config: EnvConfig) -> float:
    """Return the share of ``EPISODES`` episodes of a task that the oracle solves."""
    env = ArmVectorEnv(replace(config, image_size=1), EPISODES)
    episodes = evaluation_episodes(env.config, EPISODES, 2)
    return float(play(OracleAgent(env), env, episodes).success.mean())


def _check_oracle(config: EnvConfig) -> Check:
    """Play the oracle of the task."""
    try:
        share = oracle_success(config)
    except UserError as error:
        return Check("oracle", False, str(error), "Correct the named field.")
    return Check(
        "oracle",
        bool(share >= MIN_ORACLE),
        f"inverse kinematics succeeds in {100 * share:.0f} % of {EPISODES} episodes",
        f"Below {100 * MIN_ORACLE:.0f} %: move or shrink areas.{_area(config)} of the robot, "
        "turn the objects with target_yaws_deg, or leave objects out.",
    )


def _check_reach(scene: Scene, config: EnvConfig, k: int, places: NDArray[np.float64]) -> Check:
    grasp = target_places(scene, places) + scene.grasp_position[k]
    matrix = np.repeat(scene.grasp_matrix[k].reshape(1, 9), len(places), axis=0)
    start = np.repeat(scene.home[None], len(places), axis=0)
    solution = InverseKinematics(scene, ignore_roll=config.ignore_roll).solve(grasp, matrix, start)
    remedy = (
        f"move or shrink areas.{_area(config)} of the robot, turn the object with "
        "target_yaws_deg, or raise its grasp."
    )
    return check_reach(scene, config, k, places, start, solution, remedy)


def _images(
    scene: Scene, config: EnvConfig, places: NDArray[np.float64]
) -> tuple[list[tuple[str, Images]], NDArray[np.int16]]:
    """Draw each object alone in each of its colours, with all its parts; and without any object."""
    count = len(places)
    simulator = MujocoSimulator(scene, count, 1, "kinematic")
    everything = np.repeat(places[:, None], len(scene.targets), axis=1)
    joints = np.repeat(scene.home[None], count, axis=0)
    simulator.reset(np.arange(count), joints, everything)
    poses = simulator.geom_position, simulator.geom_matrix
    renderer = make_renderer(scene, config, config.image_size)
    paint = TargetColours(scene)
    objects: dict[str, list[int]] = {}
    for k, target in enumerate(scene.targets):
        objects.setdefault(object_of(target.name), []).append(k)
    images = []
    for name, parts in objects.items():
        shown, pairs = np.tile(parts, (count, 1)), enumerate(scene.colour_names[parts[0]])
        drawn = {c: renderer.draw(*poses, paint(shown, np.full_like(shown, i))) for i, c in pairs}
        images.append((name, {colour: image.astype(np.int16) for colour, image in drawn.items()}))
    empty = renderer.draw(*poses, resting_colours(scene, count)).astype(np.int16)
    return images, empty


def _check_differences(images: list[tuple[str, Images]]) -> list[Check]:
    """Compare every two objects of one colour, and every two colours of each object."""
    objects = [
        (f"{one} and {two} of one colour", a[colour], b[colour])
        for (one, a), (two, b) in combinations(images, 2)
        for colour in a.keys() & b.keys()
    ]
    colours = [
        (f"{name} in {a} and {b}", drawn[a], drawn[b])
        for name, drawn in images
        for a, b in combinations(drawn, 2)
    ]
    alike = "give one of them another shape or size, or leave it out."
    pale = "colour more of the object's geoms, or choose other colours."
    checks = []
    for kind, pairs, nothing, remedy in (
        ("objects", objects, "no two objects have a colour in common", alike),
        ("colours", colours, "no object has two colours", pale),
    ):
        found = [(float(np.median(different_pixels(a, b))), name) for name, a, b in pairs]
        worst, pair = min(found, default=(np.inf, ""))
        shown = f"least for {pair}: {worst:.0f} pixels (median)" if found else nothing
        remedy = f"Fewer than {MIN_DIFFERENT}: {remedy}"
        checks.append(Check(f"any two {kind} differ", worst >= MIN_DIFFERENT, shown, remedy))
    return checks
