"""Draft of a robot's description from a bare MJCF file: start pose, rectangle, yaws, camera."""

import json
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import scipy

from knowarm.arrays import Floats
from knowarm.config import from_dict
from knowarm.errors import UserError, unknown_name
from knowarm.reading import one_line
from knowarm.world.backend import MujocoSimulator
from knowarm.world.config import EnvConfig
from knowarm.world.objects import find_targets
from knowarm.world.own_robot.draft_gripper import find_gripper
from knowarm.world.own_robot.draft_reach import Layout, find_layout, spread_rad
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.mjcf import read_mjcf
from knowarm.world.scene.scene import Scene, build_scene
from knowarm.world.tasks.reward import measure

HEIGHTS_M = (0.0, 0.2, 0.4, 0.6)  # Heights of the base above the floor that are tried [m]
HOME_OFFSET_RAD, HOME_CANDIDATES = 1.3, 600
"""Largest joint distance of the start pose from a grasp's solution, and number of poses tried."""

HOME_ANGLE_DEG = (55.0, 130.0)  # Wanted angle between the start pose and every grasp [deg]
TRAVEL_RAD = 1.75  # Wanted largest travel of a joint from the start pose to a grasp [rad]
STEPS = 25  # Steps that the farthest grasp should take: half an episode, as for the shipped robots
START_RAD = 0.4
"""Largest offset of a joint of median range at the start: as of the shipped robots [rad]."""

MARGIN = 0.85  # Share of the image within which everything must lie
FOVY_DEG = 40.0
VIEW = np.array([0.62, -0.62, 0.48])
"""Direction from what is looked at to the camera: right in front and above."""


_POINT = {"rectangle_centre_m": [0.0, 0.0], "rectangle_half_size_m": [0.0, 0.0]}
NO_RECTANGLE = _POINT | {"target_yaw_deg": 0.0, "target_yaws_deg": {}}
WIDE_VIEW = {
    "camera_position_m": [20.0, -20.0, 20.0],
    "camera_look_at_m": [0.0, 0.0, 0.0],
    "camera_fovy_deg": 60.0,
}


@dataclass(frozen=True, kw_only=True)
class Draft:
    """A drafted description and how it was found."""

    robot: Robot  # The description
    fields: dict[str, Any]  # Its fields as they are written to TOML
    how: dict[str, str]  # What was chosen and why, by topic
    success_angle_deg: float  # Orientation tolerance of the task that the arm can do [deg]
    ignore_roll: bool  # Whether that task ignores the rotation about the approach axis

    def task_options(self) -> str:
        """Return the options of ``knowarm train`` for a task with an easier orientation, or ''."""
        options = []
        if self.success_angle_deg != EnvConfig.success_angle_deg:
            options.append(f"--env.success-angle-deg {self.success_angle_deg:.0f}")
        if self.ignore_roll:
            options.append("--env.ignore-roll")
        return " ".join(options)

    def toml(self, file: Path | None = None) -> str:
        """Return the description as TOML, with ``mjcf`` relative to its file if that works."""
        lines = [f"# {topic}: {text}" for topic, text in self.how.items()]
        if task := self.task_options():
            lines.append(f"# train with: {task}")
        mjcf = self.robot.mjcf.resolve()
        folder = file.resolve().parent if file else Path.cwd()
        if mjcf.is_relative_to(folder):
            mjcf = mjcf.relative_to(folder)
        for name, value in (self.fields | {"mjcf": mjcf.as_posix()}).items():
            lines.append(f"{name} = {_toml(value)}")
        return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    """Write a value in TOML's notation, mappings as inline tables."""
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{json.dumps(k)} = {_toml(v)}' for k, v in value.items())}}}"
    return json.dumps(value)


def read_overrides(settings: Sequence[str]) -> dict[str, Any]:
    """Read settings of the form ``field=value`` in TOML's notation."""
    values: dict[str, Any] = {}
    for setting in settings:
        try:
            values |= tomllib.loads(setting)
        except tomllib.TOMLDecodeError as error:
            raise UserError(
                f"Setting {setting!r} is not TOML: {one_line(error)}. Write, for example, "
                "'camera_fovy_deg=50' or 'home=[0.0, 1.5]'."
            ) from None
    names = [field.name for field in fields(Robot)]
    for name in values:
        if name not in names:
            raise unknown_name("field of a robot", name, names)
    return values


def draft_robot(path: Path, targets: Sequence[str], overrides: Mapping[str, Any]) -> Draft:
    """Draft the description of the arm in an MJCF file, which should reach objects.

    Targets are names or TOML files; overrides are fields of ``Robot`` that are not drafted.
    """
    values: dict[str, Any] = {"mjcf": str(path)}
    how = {}
    model = read_mjcf(path, str(path)).compile()
    if "joints" not in overrides or not {"tcp_site", "tcp_body"} & set(overrides):
        gripper = find_gripper(model)
        values |= {"joints": list(gripper.joints), **gripper.tcp}
        how["arm"] = gripper.how
    if "tcp_site" in overrides and "tcp_body" not in overrides:
        values = {k: v for k, v in values.items() if not k.startswith("tcp_")}
    values |= overrides
    joints = values["joints"]
    if not isinstance(joints, list):
        raise UserError(f"joints must be a list of names, got {joints!r}.")
    values.setdefault("home", _rest(model, joints))
    x, y, z = _robot(path, NO_RECTANGLE | WIDE_VIEW | values).base_position_m
    given = {"base_position_m", "table"} & set(overrides)

    def scene_at(height: float) -> Scene:
        base = {"base_position_m": [x, y, height]}
        return _wide_scene(path, values | NO_RECTANGLE | base, targets)

    layout = find_layout(scene_at, (z,) if given else HEIGHTS_M, overrides)
    scene, angle, roll = layout.scene, layout.angle_deg, layout.ignore_roll
    half_range = np.median(scene.joint_upper - scene.joint_lower) / 2
    values.setdefault("start_fraction", min(Robot.start_fraction, round(START_RAD / half_range, 3)))
    values.setdefault("base_position_m", _numbers(scene.robot.base_position_m))
    values.setdefault("rectangle_centre_m", _numbers(layout.centre_m))
    values.setdefault("rectangle_half_size_m", _numbers(layout.half_size_m))
    yaws = [branch.yaw_deg for branch in layout.branches]
    values.setdefault("target_yaw_deg", max(set(yaws), key=yaws.count))
    named = zip(scene.targets, yaws, strict=True)
    others = {target.name: yaw for target, yaw in named if yaw != values["target_yaw_deg"]}
    if others:
        values.setdefault("target_yaws_deg", others)
    how["rectangle"] = (
        f"in reach of all targets within {angle:.0f} degrees{', any roll' if roll else ''}, with "
        f"the base at {scene.robot.base_position_m[2]:.2f} m; joints differ by at most "
        f"{spread_rad(layout.branches):.2f} rad between the grasps"
    )
    scene = _wide_scene(path, values, targets)
    if "home" not in overrides:
        home, travel, text = _home(scene, layout)
        values["home"], how["home"] = _numbers(home), text
        values.setdefault("mpi_rad", round(travel / STEPS, 3))
        how["actions"] = f"{travel / values['mpi_rad']:.0f} steps of mpi_rad to the farthest grasp"
        scene = _wide_scene(path, values, targets)
    values = _camera(scene) | values
    how["camera"] = "right in front and above, so that it shows rectangle, targets and arm"
    robot = _robot(path, values)
    return Draft(robot=robot, fields=values, how=how, success_angle_deg=angle, ignore_roll=roll)


def _wide_scene(path: Path, values: dict[str, Any], targets: Sequence[str]) -> Scene:
    """Build a scene in which everything is visible, to compute with."""
    return build_scene(_robot(path, values | WIDE_VIEW), find_targets(targets))


def _robot(path: Path, values: Mapping[str, Any]) -> Robot:
    known = {"name": path.stem} | dict(values) | {"mjcf": path}
    return from_dict(Robot, known, where=str(path))


def _rest(model: mujoco.MjModel, joints: Sequence[str]) -> list[float]:
    """Return 0 for each joint, or the middle of its range where that excludes 0."""
    limited = {model.joint(j).name: model.jnt_range[j] for j in range(model.njnt)}
    ranges = [limited.get(name, (0.0, 0.0)) for name in joints]
    return _numbers([0.0 if low <= 0 <= high else (low + high) / 2 for low, high in ranges])


def _numbers(values: Any) -> list[float]:
    return [round(float(value), 4) for value in values]


def _home(scene: Scene, layout: Layout) -> tuple[Floats, float, str]:
    """Find a start pose above the support and turned away from every grasp, yet near in joints.

    Return the pose, the largest travel of a joint to a grasp [rad or m], and a description.
    """
    x, y = scene.robot.rectangle_centre_m
    support = scene.robot.support_height_m
    position = np.array([x, y, support]) + scene.grasp_position
    matrix = scene.grasp_matrix.reshape(-1, 9)
    grasps = np.concatenate([branch.joints for branch in layout.branches])
    middle = (grasps.max(axis=0) + grasps.min(axis=0)) / 2
    share = scipy.stats.qmc.Halton(scene.num_joints, scramble=False).random(HOME_CANDIDATES)
    poses = middle + HOME_OFFSET_RAD * (2 * share - 1)
    slack = 0.1 * (scene.joint_upper - scene.joint_lower)
    poses = np.clip(poses, scene.joint_lower + slack, scene.joint_upper - slack)
    simulation = MujocoSimulator(scene, len(poses))
    contacts = simulation.batch.bind("ncon")
    simulation.set_joints(poses)
    touches = contacts.reshape(-1) > 0
    tcp, frame = simulation.tcp_position, simulation.tcp_matrix
    reach = float(np.hypot(x, y))
    angles, distances = np.empty((2, len(position), len(poses)))
    for k in range(len(position)):
        goal = np.tile(position[k], (len(poses), 1)), np.tile(matrix[k], (len(poses), 1))
        distances[k], angles[k] = measure(tcp, frame, *goal, layout.ignore_roll)
    low, high = HOME_ANGLE_DEG
    travel = np.abs(poses[:, None] - grasps).max(axis=(1, 2))
    penalty = (
        100.0 * touches
        + 20.0 * (tcp[:, 2] < support + 0.3 * reach)
        + 5.0 * (tcp[:, 2] > support + 1.2 * reach)
        + 10.0 * (frame[:, 8] > 0.3)
        + 10.0 * (np.hypot(tcp[:, 0], tcp[:, 1]) < 0.35 * reach)
        + 10.0 * (tcp[:, 0] < 0.2 * reach)
        + 0.1 * np.maximum(low - angles.min(axis=0), 0)
        + 0.1 * np.maximum(angles.max(axis=0) - high, 0)
        + 10.0 * np.maximum(travel - TRAVEL_RAD, 0)
        + 10.0 * np.maximum(0.3 - distances.min(axis=0) / reach, 0)
        + 10.0 * np.maximum(distances.max(axis=0) / reach - 1, 0)
        + np.abs(tcp[:, 1]) / reach
    )
    best = int(penalty.argmin())
    text = (
        f"gripper {tcp[best, 2] - support:.2f} m above the support, {angles[:, best].min():.0f} "
        f"to {angles[:, best].max():.0f} degrees and {distances[:, best].min():.2f} m from the "
        f"grasps at the rectangle's middle"
    )
    return poses[best], float(travel[best]), text


def _camera(scene: Scene) -> dict[str, Any]:
    """Place the camera so that it shows the rectangle with its targets, and the arm."""
    robot = scene.robot
    data = mujoco.MjData(scene.model)
    data.qpos[scene.qpos_index] = scene.home
    mujoco.mj_kinematics(scene.model, data)
    centre, half = np.array(robot.rectangle_centre_m), np.array(robot.rectangle_half_size_m)
    support = robot.support_height_m
    corners = [
        [*(centre + half * [sx, sy]), support + z]
        for sx in (-1, 1)
        for sy in (-1, 1)
        for z in (0.0, float(scene.grasp_position[:, 2].max()) * 1.2)
    ]
    roots = scene.model.body_rootid
    bodies = data.xpos[1:][scene.model.body_mocapid[roots[1:]] < 0]
    points = np.array([*corners, *bodies, data.site_xpos[scene.tcp_site]])
    look_at = (points.max(axis=0) + points.min(axis=0)) / 2
    backward = VIEW / np.linalg.norm(VIEW)
    right = np.cross([0.0, 0.0, 1.0], backward)
    right /= np.linalg.norm(right)
    up = np.cross(backward, right)
    local = (points - look_at) @ np.stack([right, up, backward], axis=1)
    slope = math.tan(math.radians(FOVY_DEG) / 2) * MARGIN
    distance = float((np.abs(local[:, :2]).max(axis=1) / slope + local[:, 2]).max())
    return {
        "camera_position_m": _numbers(look_at + distance * backward),
        "camera_look_at_m": _numbers(look_at),
        "camera_fovy_deg": FOVY_DEG,
    }
