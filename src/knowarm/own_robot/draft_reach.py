"""Reach of a drafted robot: base height, rectangle and targets' directions, searched at once."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from knowarm.arrays import Floats, Integers, Mask
from knowarm.errors import UserError
from knowarm.own_robot.poses import Fields, sample_joints, sample_tips
from knowarm.world.scene.scene import Scene, target_places
from knowarm.world.tasks.skills.ik import IKSolution, InverseKinematics

YAWS_DEG = (180.0, -135.0, 135.0, -90.0, 90.0)
"""Directions of the targets that are tried [deg]."""

LARGEST = np.array([0.18, 0.4])
"""Half-sizes of the rectangle, relative to the reach: those of the shipped robots."""

RECTANGLES = tuple(product((1.0, 0.75, 0.5), (0.6, 0.5, 0.7)))
"""Sizes relative to the largest, and distances of the centre relative to the reach, best first."""

NODES = np.array(list(product((0, -1, 1), repeat=2)))
"""Places in a rectangle, relative to its half-sizes; its centre first."""

STARTS = 16  # Random joint angles from which solutions are searched at the centre
TOLERANCES_DEG = {False: (15.0,), True: (15.0, 30.0, 45.0, 60.0, 90.0)}
"""Success angles from the strictest to the easiest, by whether the roll is ignored."""

MARGIN_DEG = 2.0  # Least distance of a solution from the success angle
DISTANCE_M = 0.03  # Of a place that counts as reached from the grasp point
SPREAD_RAD = 2.5  # Greatest wanted difference of a joint between two grasps


class Branch(NamedTuple):
    """Grasps of a target at N places with J joint angles that change little between them."""

    yaw_deg: float  # Direction of the target
    angle_deg: float  # Largest error of the orientation
    joints: Floats  # Joint angles, (N, J) [rad]


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Where a robot can grasp its targets, and how."""

    scene: Scene  # Scene with the base at its height
    angle_deg: float  # Strictest success angle
    ignore_roll: bool  # Whether the roll about the approach axis has to be ignored
    centre_m: Floats  # Centre of the rectangle, (2,)
    half_size_m: Floats  # Half-sizes of the rectangle, (2,)
    branches: Sequence[Branch]  # How each target is grasped

    @property
    def cost(self) -> tuple[float, bool, float]:
        """What is better is smaller: an easier task, distant grasps, a small rectangle."""
        far = spread_rad(self.branches) > SPREAD_RAD
        return self.angle_deg + self.ignore_roll, far, -self.half_size_m[0]


def spread_rad(branches: Sequence[Branch]) -> float:
    """Return the largest difference of a joint between two grasps of any targets [rad]."""
    joints = np.concatenate([branch.joints for branch in branches])
    return float(np.ptp(joints, axis=0).max())


def reach_m(scene: Scene) -> float:
    """Return how far the gripper reaches at the height of the grasps; 0 if never [m]."""
    x, y, z = sample_tips(scene, 3000).T
    high = max(0.1, scene.grasp_position[:, 2].max() * 1.5)
    near = (z > 0) & (z < high)
    distance = np.hypot(x[near], y[near])
    if len(distance) < 10:
        return 0.0
    return float(np.percentile(distance, 95))


def find_layout(
    scene_at: Callable[[float], Scene],
    heights: Sequence[float],
    given: Fields,
) -> Layout:
    """Search base height, rectangle and directions of the targets for the strictest task.

    Fields of the description that are given are not searched. The first height is taken at which
    the task as it is can be done with grasps near each other in joint angles, else the best one.
    """
    best: Layout | None = None
    most: dict[str, int] = {}
    for ignore_roll in TOLERANCES_DEG:
        for height in heights:
            scene = scene_at(height)
            counts = np.zeros(len(scene.targets), np.int64)
            for layout in _layouts(scene, ignore_roll, given, counts):
                if best is None or layout.cost < best.cost:
                    best = layout
                if best.cost < (TOLERANCES_DEG[False][0], True):
                    return best
            for target, count in zip(scene.targets, counts, strict=True):
                most[f"{target.name} at {height:.2f} m"] = int(count)
        if best is not None:
            return best
    raise UserError(
        f"Robot {scene.robot.name!r}: inverse kinematics reaches no rectangle in front of it with "
        f"any of the orientation tolerances tried. Places reached, of {len(NODES)}, by target and "
        f"height of the base: {', '.join(f'{name} {n}' for name, n in most.items())}. Give "
        "another base_position_m or base_yaw_deg (the arm should face x), a table, other targets, "
        "or other joints, or check their ranges and the TCP."
    )


def _layouts(
    scene: Scene, ignore_roll: bool, given: Fields, counts: Integers
) -> Iterator[Layout]:
    """Yield the layouts at a base height; count the places reached at best per target."""
    reach = reach_m(scene)
    if not reach:
        return
    turned = given.get("target_yaws_deg", {})
    cases: list[
        tuple[int, float]
    ] = []  # Targets with a direction that is given or tried
    for k, target in enumerate(scene.targets):
        yaw = turned.get(target.name, given.get("target_yaw_deg"))
        cases += product([k], YAWS_DEG if yaw is None else [yaw])
    for size, distance in RECTANGLES:
        centre = np.array(given.get("rectangle_centre_m", (distance * reach, 0.0)))
        half = np.array(given.get("rectangle_half_size_m", size * LARGEST * reach))
        branches = _branches(scene, ignore_roll, centre + NODES * half, cases, counts)
        for angle in TOLERANCES_DEG[ignore_roll]:
            fitting = [_within(alternatives, angle) for alternatives in branches]
            if all(fitting):
                yield Layout(
                    scene=scene,
                    angle_deg=angle,
                    ignore_roll=ignore_roll,
                    centre_m=centre,
                    half_size_m=half,
                    branches=_nearest(fitting),
                )
                break


def _within(branches: Sequence[Branch], angle_deg: float) -> list[Branch]:
    """Return the branches within a success angle."""
    return [branch for branch in branches if branch.angle_deg < angle_deg - MARGIN_DEG]


def _branches(
    scene: Scene,
    ignore_roll: bool,
    places: Floats,
    cases: Sequence[tuple[int, float]],
    counts: Integers,
) -> list[list[Branch]]:
    """Find solutions at the first of N places (N, 2) and follow them to the others.

    Cases are targets with a direction [deg]. Return the branches of each target.
    """
    n = len(places)
    target, yaw = np.array(cases).T
    target = target.astype(np.intp)
    turn = Rotation.from_euler("z", yaw[:, None], degrees=True).as_matrix()
    offset = (turn @ scene.grasp_position[target][..., None]).transpose(0, 2, 1)
    position = target_places(scene, places) + offset
    matrix = (turn @ scene.grasp_matrix[target]).reshape(-1, 9)
    solver = InverseKinematics(scene, starts=1, ignore_roll=ignore_roll)
    starts = np.vstack([scene.home, sample_joints(scene, STARTS)])
    case = np.repeat(np.arange(len(cases)), len(starts))
    start = np.tile(starts, (len(cases), 1))
    first = solver.solve(position[case, 0], matrix[case], start, attempts=1)
    # Solutions that round to the same angles are one branch.
    good = np.flatnonzero(_is_good(first, ignore_roll))
    same = np.column_stack([case, first.joints.round()])[good]
    good = good[np.unique(same, axis=0, return_index=True)[1]]
    branches: list[list[Branch]] = [[] for _ in scene.targets]
    if not len(good):
        return branches
    case = case[good]
    follow = solver.solve(
        position[case].reshape(-1, 3),
        np.repeat(matrix[case], n, axis=0),
        np.repeat(first.joints[good], n, axis=0),
        attempts=1,
    )
    near = _is_good(follow, ignore_roll).reshape(-1, n)
    angle = follow.angle.reshape(-1, n).max(axis=1)
    joints = follow.joints.reshape(len(good), n, -1)
    np.maximum.at(counts, target[case], near.sum(axis=1))
    for i in np.flatnonzero(near.all(axis=1)):
        branch = Branch(float(yaw[case[i]]), float(angle[i]), joints[i])
        branches[target[case[i]]].append(branch)
    return branches


def _is_good(solution: IKSolution, ignore_roll: bool) -> Mask:
    """Return which solutions the easiest task accepts."""
    return solution.within(DISTANCE_M, TOLERANCES_DEG[ignore_roll][-1] - MARGIN_DEG)


def _nearest(branches: Sequence[Sequence[Branch]]) -> list[Branch]:
    """Choose a branch per target, so that all grasps are near each other in joint angles."""
    choices = [[first] for first in branches[0]]
    for choice in choices:
        for others in branches[1:]:
            choice.append(min(others, key=lambda other: spread_rad([*choice, other])))
    return min(choices, key=spread_rad)
