"""Checks of the objects of the choice task: reach, visibility, and differences in the image."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.appearance import TargetColours, resting_colours
from knowarm.world.arrays import IndexSelection
from knowarm.world.backends.mujoco import MujocoSimulator
from knowarm.world.config import EnvConfig, choice_env_config
from knowarm.world.ik import InverseKinematics
from knowarm.world.render.renderer import make_renderer
from knowarm.world.robot_check import (
    DIFFERENCE,
    MIN_PIXELS,
    MIN_REACHABLE,
    Check,
    check_result,
    is_reachable,
)
from knowarm.world.scene import Scene, scene_of, target_places

PLACES = 4
"""Positions per side of the grid over the rectangle at which objects are checked."""

MIN_DIFFERENT = 6
"""Least number of pixels in which two objects of one colour differ, or one in two colours."""


def check_objects(robot: str, targets: Sequence[str]) -> list[Check]:
    """Check objects in the rectangle in which several of them stand.

    Args:
        robot: a name in ``ROBOTS``, or a TOML file.
        targets: names or TOML files of the objects.

    Returns:
        The results in order; only the first if the scene cannot be built.
    """
    count = min(4, len(targets))
    try:
        config = choice_env_config(robot, targets=tuple(targets))
        scene = scene_of(config)
    except UserError as error:
        return [check_result("scene", False, str(error), "Correct the named field.")]
    places = _grid(scene)
    checks = [check_result("scene", True, f"{len(targets)} objects, {count} per episode")]
    checks += [_check_reach(scene, config, k, places) for k in range(len(targets))]
    images, empty = _images(scene, config, places)
    checks += [_check_visible(scene, k, images[k], empty) for k in range(len(targets))]
    return [*checks, _check_shapes(scene, images), _check_colours(scene, images)]


def _grid(scene: Scene) -> NDArray[np.float64]:
    """Return positions from border to border of the rectangle, (P, 2) [m]."""
    side = np.linspace(-1, 1, PLACES)
    signed = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    return np.asarray(scene.robot.rectangle_centre_m + signed * scene.robot.rectangle_half_size_m)


def _check_reach(scene: Scene, config: EnvConfig, k: int, places: NDArray[np.float64]) -> Check:
    grasp = target_places(scene, places) + scene.grasp_position[k]
    matrix = np.repeat(scene.grasp_matrix[k].reshape(1, 9), len(places), axis=0)
    start = np.repeat(scene.home[None], len(places), axis=0)
    solution = InverseKinematics(scene).solve(grasp, matrix, start)
    reached = is_reachable(solution, start, scene, config)
    x, y = places[~reached].mean(axis=0) if not reached.all() else (0.0, 0.0)
    return check_result(
        f"reach of {scene.targets[k].name}",
        bool(reached.mean() >= MIN_REACHABLE),
        f"{reached.sum()} of {len(places)} positions reachable in time and without contact",
        f"Not reached: positions around x {x:.2f}, y {y:.2f} m: move or shrink "
        "choice_half_size_m, turn the object with target_yaws_deg, or raise its grasp.",
    )


def _images(
    scene: Scene, config: EnvConfig, places: NDArray[np.float64]
) -> tuple[list[NDArray[np.int16]], NDArray[np.int16]]:
    """Draw each object alone: C x P images per object, and P without any object."""
    count = len(places)
    simulator = MujocoSimulator(scene, count, 1, "kinematic")
    everything = np.repeat(places[:, None], len(scene.targets), axis=1)
    joints = np.repeat(scene.home[None], count, axis=0)
    simulator.reset(IndexSelection(np.arange(count)), joints, everything)
    poses = simulator.geom_position, simulator.geom_matrix
    renderer = make_renderer(scene, config, config.image_size)
    paint = TargetColours(scene)
    images = [
        np.stack(
            [
                renderer.draw(*poses, paint(np.full(count, k), np.full(count, c))).astype(np.int16)
                for c in range(len(target.colours))
            ]
        )
        for k, target in enumerate(scene.targets)
    ]
    empty = renderer.draw(*poses, resting_colours(scene, count)).astype(np.int16)
    return images, empty


def _different(a: NDArray[np.int16], b: NDArray[np.int16]) -> NDArray[np.int64]:
    """Count the pixels in which images (..., H, W, 3) differ, (...)."""
    return np.asarray((np.abs(a - b).max(axis=-1) > DIFFERENCE).sum(axis=(-2, -1)))


def _check_visible(
    scene: Scene, k: int, images: NDArray[np.int16], empty: NDArray[np.int16]
) -> Check:
    pixels = _different(images, empty)
    few = float(np.percentile(pixels, 5))
    return check_result(
        f"{scene.targets[k].name} in the image",
        few >= MIN_PIXELS,
        f"in {np.median(pixels):.0f} pixels (median), {few:.0f} (5th percentile)",
        f"Fewer than {MIN_PIXELS}: enlarge the object or move the camera nearer.",
    )


def _check_shapes(scene: Scene, images: list[NDArray[np.int16]]) -> Check:
    """Compare every two objects of the same colour at the same position."""
    worst, pair = np.inf, ("", "")
    for a, b in combinations(range(len(images)), 2):
        names = scene.colour_names
        for colour in set(names[a]) & set(names[b]):
            shown = images[a][names[a].index(colour)], images[b][names[b].index(colour)]
            pixels = float(np.median(_different(*shown)))
            if pixels < worst:
                worst, pair = pixels, (scene.targets[a].name, scene.targets[b].name)
    return check_result(
        "any two objects differ",
        worst >= MIN_DIFFERENT,
        "no two objects have a colour in common"
        if np.isinf(worst)
        else f"least for {pair[0]} and {pair[1]} of one colour: {worst:.0f} pixels (median)",
        f"Fewer than {MIN_DIFFERENT}: give one of them another shape or size, or leave it out.",
    )


def _check_colours(scene: Scene, images: list[NDArray[np.int16]]) -> Check:
    """Compare every two colours of each object."""
    worst, pair = np.inf, ("", "", "")
    for k, drawn in enumerate(images):
        for a, b in combinations(range(len(drawn)), 2):
            pixels = float(np.median(_different(drawn[a], drawn[b])))
            if pixels < worst:
                worst = pixels
                pair = (scene.targets[k].name, scene.colour_names[k][a], scene.colour_names[k][b])
    return check_result(
        "any two colours differ",
        worst >= MIN_DIFFERENT,
        "no object has two colours"
        if np.isinf(worst)
        else f"least for {pair[0]} in {pair[1]} and {pair[2]}: {worst:.0f} pixels (median)",
        f"Fewer than {MIN_DIFFERENT}: colour more of the object's geoms, or choose other colours.",
    )
