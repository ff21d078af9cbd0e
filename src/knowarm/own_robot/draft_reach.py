"""Reach of a drafted robot: base height, rectangle and targets' directions, searched at once."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from knowarm.arrays import Floats
from knowarm.errors import UserError
from knowarm.world.backend import MujocoSimulator
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.skills.ik import InverseKinematics

YAWS_DEG = (180.0, -135.0, 135.0, -90.0, 90.0)  # Directions of the targets that are tried [deg]
LARGEST = np.array([0.18, 0.4])
"""Half-sizes of the rectangle, relative to the reach: those of the shipped robots."""

RECTANGLES = tuple(product((1.0, 0.75, 0.5), (0.6, 0.5, 0.7)))
"""Sizes relative to the largest, and distances of the centre relative to the reach, best first."""

NODES = np.array(list(product((0, -1, 1), (0, -1, 1))))  # Places in a rectangle; its centre first
STARTS = 16  # Random joint angles from which solutions are searched at the centre
TOLERANCES = ((15.0, False), (15.0, True), (30.0, True), (45.0, True), (60.0, True), (90.0, True))
"""Success angles [deg] and whether the roll is ignored, from the task as it is to the easiest."""

DISTANCE_M = 0.03  # Distance from the grasp point within which a place counts as reached [m]
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
    return float(np.ptp(np.concatenate([each.joints for each in branches]), axis=0).max())


def samples(scene: Scene, count: int) -> Floats:
    """Spread joint angles over their ranges, (count, J)."""
    share = scipy.stats.qmc.Halton(scene.num_joints, scramble=False).random(count)
    return np.asarray(scene.joint_lower + share * (scene.joint_upper - scene.joint_lower))


def reach_m(scene: Scene) -> float:
    """Return how far the gripper reaches at the height of the grasps; 0 if never [m]."""
    joints = samples(scene, 3000)
    simulation = MujocoSimulator(scene, len(joints))
    simulation.set_joints(joints)
    place = simulation.tcp_position
    high = max(0.1, float(scene.grasp_position[:, 2].max()) * 1.5)
    near = (place[:, 2] > 0) & (place[:, 2] < high)
    distance = np.hypot(place[near, 0], place[near, 1])
    return float(np.percentile(distance, 95)) if len(distance) >= 10 else 0.0


def find_layout(
    scene_at: Callable[[float], Scene], heights: Sequence[float], given: Mapping[str, Any]
) -> Layout:
    """Search base height, rectangle and directions of the targets for the strictest task.

    Fields of the description that are given are not searched. The first height is taken at which
    the task as it is can be done with grasps near each other in joint angles, else the best one.
    """
    best: Layout | None = None
    most: dict[str, int] = {}
    for roll in (False, True):
        for height in heights:
            scene = scene_at(height)
            counts = {f"{target.name} at {height:.2f} m": 0 for target in scene.targets}
            for layout in _layouts(scene, roll, given, counts):
                best = layout if best is None or layout.cost < best.cost else best
                if best.cost < (TOLERANCES[0][0], True):
                    return best
            most |= counts
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
    scene: Scene, roll: bool, given: Mapping[str, Any], counts: dict[str, int]
) -> Iterator[Layout]:
    """Yield the layouts at a base height; count the places reached at best per target."""
    reach = reach_m(scene)
    turned = given.get("target_yaws_deg", {})
    yaws = [turned.get(target.name, given.get("target_yaw_deg")) for target in scene.targets]
    cases = [(k, y) for k, yaw in enumerate(yaws) for y in (YAWS_DEG if yaw is None else (yaw,))]
    for size, centre in RECTANGLES if reach else ():
        middle = np.array(given.get("rectangle_centre_m", (centre * reach, 0.0)))
        half = np.array(given.get("rectangle_half_size_m", size * LARGEST * reach))
        found = _branches(scene, roll, middle + NODES * half, cases, counts)
        for angle in (angle for angle, free in TOLERANCES if free is roll):
            fits = [[each for each in some if each.angle_deg < angle - 2] for some in found]
            if all(fits):
                yield Layout(
                    scene=scene,
                    angle_deg=angle,
                    ignore_roll=roll,
                    centre_m=middle,
                    half_size_m=half,
                    branches=_nearest(fits),
                )
                break


def _branches(
    scene: Scene,
    roll: bool,
    places: Floats,
    cases: Sequence[tuple[int, float]],
    counts: dict[str, int],
) -> list[list[Branch]]:
    """Find solutions at the first of N places (N, 2) and follow them to the others.

    Cases are targets with a direction [deg]. Return the branches of each target.
    """
    target, yaw = np.array(cases).T
    turn = Rotation.from_euler("z", yaw[:, None], degrees=True).as_matrix()
    target = target.astype(np.intp)
    ground = np.column_stack([places, np.full(len(places), scene.robot.support_height_m)])
    position = ground + (turn @ scene.grasp_position[target][..., None]).transpose(0, 2, 1)
    matrix = (turn @ scene.grasp_matrix[target]).reshape(-1, 9)
    solver = InverseKinematics(scene, starts=1, ignore_roll=roll)
    starts = np.concatenate([scene.home[None], samples(scene, STARTS)])
    row = np.repeat(np.arange(len(cases)), len(starts))
    start = np.tile(starts, (len(cases), 1))
    first = solver.solve(position[row, 0], matrix[row], start, attempts=1)
    limit_deg = max(angle for angle, free in TOLERANCES if free is roll) - 2
    good = np.flatnonzero(first.within(DISTANCE_M, limit_deg))
    branches: list[list[Branch]] = [[] for _ in scene.targets]
    if not len(good):
        return branches
    # Solutions that round to the same angles are one branch.
    same = np.column_stack([row[good], first.joints[good].round()])
    good = good[np.unique(same, axis=0, return_index=True)[1]]
    case, n = row[good], len(places)
    start = np.repeat(first.joints[good], n, axis=0)
    poses = position[case].reshape(-1, 3), np.repeat(matrix[case], n, axis=0)
    follow = solver.solve(*poses, start, attempts=1)
    near = follow.within(DISTANCE_M, limit_deg).reshape(-1, n)
    angle, joints = follow.angle.reshape(-1, n), follow.joints.reshape(len(good), n, -1)
    for i, k in enumerate(target[case]):
        name = list(counts)[k]
        counts[name] = max(counts[name], int(near[i].sum()))
        if near[i].all():
            branches[k].append(Branch(float(yaw[case[i]]), float(angle[i].max()), joints[i]))
    return branches


def _nearest(branches: Sequence[Sequence[Branch]]) -> list[Branch]:
    """Choose a branch per target, so that all grasps are near each other in joint angles."""
    chosen = [[first] for first in branches[0]]
    for others in branches[1:]:
        for some in chosen:
            some.append(min(others, key=lambda other: spread_rad([*some, other])))
    return min(chosen, key=spread_rad)
