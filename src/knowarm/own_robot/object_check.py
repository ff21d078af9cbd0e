"""Checks of the objects of a task with several: reach, visibility, differences in the image."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import Any

import numpy as np

from knowarm.arrays import Floats, Images
from knowarm.check import Check
from knowarm.errors import UserError
from knowarm.own_robot.pixels import SceneImages, different_pixels
from knowarm.own_robot.poses import grasps, place_targets, rectangle_places
from knowarm.own_robot.robot_check import StraightPath, check_reach, check_visible
from knowarm.questions import object_of
from knowarm.world.agents import OracleAgent
from knowarm.world.agents.play import play
from knowarm.world.agents.protocol import PrivilegedAgent
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
        area = config.task.area_of(find_robot(robot))
        scene = load_scene(config.robot, config.targets, area=area)
    except UserError as error:
        return [Check("scene", False, str(error), "Correct what that line names.")]
    line = np.linspace(-1, 1, PLACES)  # From border to border of the rectangle
    signs = np.array([(x, y) for y, x in product(line, line)])
    found = f"{len(config.targets)} targets, {config.task.asked.visible} per episode"
    checks = [Check("scene", True, found)]
    remedy = (
        f"move or shrink areas.{area} of the robot, turn the object with target_yaws_deg, or raise "
        "its grasp."
    )
    solver = InverseKinematics(scene, ignore_roll=config.ignore_roll)
    start = np.tile(scene.home, (len(signs), 1))
    for k, grasp in enumerate(zip(*grasps(scene, signs), strict=True)):
        path = StraightPath(scene, config, start, solver.solve(*grasp, start))
        places = rectangle_places(scene.robot, signs)
        checks.append(check_reach(path, k, places, remedy))
    checks += _check_images(scene, config, signs)
    if all(check.ok for check in checks):
        checks.append(_check_oracle(config, area))
    return checks


def oracle_success(
    config: EnvConfig, agent: type[PrivilegedAgent] = OracleAgent
) -> float:
    """Return the share of ``EPISODES`` episodes of a task that the oracle, or another, solves."""
    env = ArmVectorEnv(replace(config, image_size=1), EPISODES)
    episodes = evaluation_episodes(env.config, EPISODES, 2)
    return float(play(agent(env), env, episodes).success.mean())


def _check_oracle(config: EnvConfig, area: str) -> Check:
    """Play the oracle of the task."""
    try:
        share = oracle_success(config)
    except UserError as error:
        return Check("oracle", False, str(error), "Correct the named field.")
    return Check(
        "oracle",
        share >= MIN_ORACLE,
        f"inverse kinematics succeeds in {100 * share:.0f} % of {EPISODES} episodes",
        f"Below {100 * MIN_ORACLE:.0f} %: move or shrink areas.{area} of the robot, "
        "turn the objects with target_yaws_deg, or leave objects out.",
    )


def _check_images(scene: Scene, config: EnvConfig, signs: Floats) -> Iterator[Check]:
    """Check that every object is seen, and any two, and any two of its colours, differ."""
    images = SceneImages(scene, place_targets(scene, scene.home, signs), config)
    targets_by_object: dict[str, list[int]] = {}
    for k, target in enumerate(scene.targets):
        targets_by_object.setdefault(object_of(target.name), []).append(k)
    # Of an object alone in a colour
    images_by_facet: dict[tuple[str, str], Images] = {}
    for name, targets in targets_by_object.items():
        names = scene.colour_names[targets[0]]
        for i, colour in enumerate(names):
            images_by_facet[name, colour] = images.targets(targets, i)
        drawn = np.stack([images_by_facet[name, colour] for colour in names])
        remedy = "enlarge the object or move the camera nearer."
        yield check_visible(name, drawn, images.empty, remedy)
    objects = []
    colours = []
    for (one, colour), (other, changed) in combinations(images_by_facet, 2):
        change = different_pixels(
            images_by_facet[one, colour], images_by_facet[other, changed]
        )
        pixels = float(np.median(change))
        if colour == changed:
            objects.append((pixels, f"{one} and {other} of one colour"))
        elif one == other:
            colours.append((pixels, f"{one} in {colour} and {changed}"))
    yield _check_least(
        "objects",
        objects,
        "no two objects have a colour in common",
        "give one of them another shape or size, or leave it out.",
    )
    yield _check_least(
        "colours",
        colours,
        "no object has two colours",
        "colour more of the object's geoms, or choose other colours.",
    )


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
