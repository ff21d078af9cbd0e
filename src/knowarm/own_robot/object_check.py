"""Checks of the objects of a task with several: reach, visibility, differences in the image."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import Any

import numpy as np

from knowarm.arrays import Floats
from knowarm.check import Check
from knowarm.errors import UserError
from knowarm.own_robot.pixels import Images, SceneImages, different_pixels
from knowarm.own_robot.poses import grasps, place_targets, rectangle_places
from knowarm.own_robot.robot_check import Way, check_reach, check_visible
from knowarm.questions import object_of
from knowarm.world.agents import OracleAgent
from knowarm.world.agents.play import play
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.robots import find_robot
from knowarm.world.scene.scene import Scene, load_scene
from knowarm.world.tasks import find_task
from knowarm.world.tasks.skills.ik import InverseKinematics

PLACES = 4
"""Positions per side of the grid over the rectangle at which objects are checked."""

EPISODES = 60  # That the oracle plays
MIN_ORACLE = 0.8  # Its least success
MIN_DIFFERENT = 6
"""Least number of pixels in which two objects of one colour differ, or one in two colours."""

Shown = dict[str, dict[str, Images]]
"""Images at P places, (P, H, W, 3), by the name of the object and that of its colour."""


def check_objects(
    robot: str, task: str, targets: Sequence[str] = (), **options: Any
) -> list[Check]:
    """Check objects, or those of the task, in the area of a robot in which the task places them.

    Options are other fields of ``EnvConfig``. Return the results in order; only the first if the
    scene cannot be built.
    """
    try:
        config = EnvConfig(
            robot=robot, task=find_task(task), targets=tuple(targets), **options
        )
        scene = load_scene(config.robot, config.targets, area=_area(config))
    except UserError as error:
        return [Check("scene", False, str(error), "Correct what that line names.")]
    line = np.linspace(-1, 1, PLACES)
    # From border to border of the rectangle, (P, 2) [m].
    places = rectangle_places(scene.robot, [(x, y) for y, x in product(line, line)])
    found = f"{len(config.targets)} targets, {config.task.asked.visible} per episode"
    checks = [Check("scene", True, found)]
    checks += _check_reach(scene, config, places)
    images = SceneImages(scene, place_targets(scene, scene.home, places), config)
    shown = _draw_objects(scene, images)
    for name, colours in shown.items():
        drawn = np.stack([*colours.values()])
        remedy = "enlarge the object or move the camera nearer."
        checks.append(check_visible(name, drawn, images.empty, remedy))
    checks += _check_differences(shown)
    if all(check.ok for check in checks):
        checks.append(_check_oracle(config))
    return checks


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


def _check_reach(scene: Scene, config: EnvConfig, places: Floats) -> list[Check]:
    """Check the reach of each target."""
    remedy = (
        f"move or shrink areas.{_area(config)} of the robot, turn the object with "
        "target_yaws_deg, or raise its grasp."
    )
    solver = InverseKinematics(scene, ignore_roll=config.ignore_roll)
    start = np.tile(scene.home, (len(places), 1))
    checks = []
    for k, (position, matrix) in enumerate(zip(*grasps(scene, places), strict=True)):
        way = Way(scene, config, start, solver.solve(position, matrix, start))
        checks.append(check_reach(way, k, places, remedy))
    return checks


def _draw_objects(scene: Scene, images: SceneImages) -> Shown:
    """Draw each object alone in each of its colours, with all its parts."""
    parts: dict[str, list[int]] = {}
    for k, target in enumerate(scene.targets):
        parts.setdefault(object_of(target.name), []).append(k)
    shown: Shown = {}
    for name, targets in parts.items():
        colours = enumerate(scene.colour_names[targets[0]])
        shown[name] = {colour: images.targets(targets, i) for i, colour in colours}
    return shown


def _check_differences(shown: Shown) -> list[Check]:
    """Compare every two objects of one colour, and every two colours of each object."""
    objects = []
    for (one, images), (other, others) in combinations(shown.items(), 2):
        for colour in images.keys() & others.keys():
            pixels = _difference(images[colour], others[colour])
            objects.append((pixels, f"{one} and {other} of one colour"))
    colours = []
    for name, images in shown.items():
        for one, other in combinations(images, 2):
            pixels = _difference(images[one], images[other])
            colours.append((pixels, f"{name} in {one} and {other}"))
    return [
        _check_least(
            "objects",
            objects,
            "no two objects have a colour in common",
            "give one of them another shape or size, or leave it out.",
        ),
        _check_least(
            "colours",
            colours,
            "no object has two colours",
            "colour more of the object's geoms, or choose other colours.",
        ),
    ]


def _difference(a: Images, b: Images) -> float:
    """Return the median number of pixels in which images differ."""
    return float(np.median(different_pixels(a, b)))


def _check_least(
    kind: str, pairs: list[tuple[float, str]], nothing: str, remedy: str
) -> Check:
    """Check that the two of a kind that differ in the fewest pixels differ enough."""
    pixels, pair = min(pairs, default=(np.inf, ""))
    return Check(
        f"any two {kind} differ",
        pixels >= MIN_DIFFERENT,
        f"least for {pair}: {pixels:.0f} pixels (median)" if pairs else nothing,
        f"Fewer than {MIN_DIFFERENT}: {remedy}",
    )
