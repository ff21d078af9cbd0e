"""Draft of a robot's description from a bare MJCF file: start pose, rectangle, yaws, camera."""

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np

from knowarm.config import from_dict
from knowarm.errors import UserError, unknown_name
from knowarm.own_robot.draft_area import find_area
from knowarm.own_robot.draft_base import lowest_fixed_m, place_base
from knowarm.own_robot.draft_gripper import find_gripper
from knowarm.own_robot.draft_home import STEPS, Home, find_homes
from knowarm.own_robot.draft_reach import find_layout, spread_rad
from knowarm.own_robot.draft_view import FOVY_DEG, choose_view
from knowarm.own_robot.robot_check import EVALUATION_M, MAX_BLIND, fixed_list_success
from knowarm.own_robot.servo_check import MAX_LAG_RAD, best_frequency, servo_lag
from knowarm.reading import one_line
from knowarm.world.config import EnvConfig
from knowarm.world.objects import find_targets
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.mjcf import read_mjcf
from knowarm.world.scene.scene import Scene, build_scene
from knowarm.world.tasks.skills import SKILLS

HEIGHTS_M = (0.0, 0.2, 0.4, 0.6, -0.2, -0.4, -0.6)
"""Changes of the base's height that are tried, of which it must stay above the floor [m]."""

BASE_FIELDS = {"base_position_m", "base_yaw_deg", "table"}
"""Fields that say where the base is; if one is given, no other place is searched."""

SCALE, EASY_DEG = 0.35, 30.0
"""Distance of success in an evaluation relative to half the diagonal of the rectangle, at most
`EVALUATION_M`, and the angle above which it is at most that of the task: a small arm, or one of
few joints, is not tested with thresholds that a fixed list of actions meets."""

LEAST_M, STEP_M, SHRINK, WANTED_BLIND = 0.02, 0.005, 0.7, MAX_BLIND - 0.1
"""Least distance of success and its multiples [m], the factor by which it shrinks while a fixed
list of actions solves too much, and the success of the list from which it stays."""

START_RAD = 0.4
"""Largest offset of a joint of median range at the start: as of the shipped robots [rad]."""

JOINT_MAP = (
    "# The real arm, for knowarm serve, ros, record and export, in its order: value = sign * angle",
    '# + offset, in the unit: "rad", "deg", or LeRobot\'s "range_0_100" and "range_m100_100".',
    "[joint_map]",
)
UNCHANGED = 'sign = 1, offset = 0.0, unit = "rad"'
"""Lines of a drafted joint map, which converts nothing; a held joint is sent if it is named."""

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
    distance_m: float  # Distance within which an evaluation counts success [m]

    def task_options(self) -> str:
        """Return the options of ``knowarm train`` for the task that the arm can do, or ''."""
        options = []
        if self.distance_m < EnvConfig.success_distance_m:
            options.append(f"--env.success-distance-m {self.distance_m:g}")
        if self.success_angle_deg != EnvConfig.success_angle_deg:
            options.append(f"--env.success-angle-deg {self.success_angle_deg:.0f}")
        if self.ignore_roll:
            options.append("--env.ignore-roll")
        return " ".join(options)

    def evaluation_options(self) -> str:
        """Return the options of ``knowarm evaluate`` for the task that the arm can do, or ''."""
        eased = self.success_angle_deg != EnvConfig.success_angle_deg
        near = self.distance_m < EVALUATION_M
        angle = f"--angle-deg {self.success_angle_deg:.0f}" if eased else ""
        return f"{angle} {f'--distance-m {self.distance_m:g}' if near else ''}".strip()

    def toml(self, file: Path | None = None, **given: Any) -> str:
        """Return the description as TOML, with ``mjcf`` relative to its file if that works.

        ``given`` replaces fields of the description.
        """
        lines = [f"# {topic}: {text}" for topic, text in self.how.items()]
        if task := self.task_options():
            lines.append(f"# train with: {task}")
        if options := self.evaluation_options():
            lines.append(f"# evaluate with: {options}")
        mjcf = self.robot.mjcf.resolve()
        folder = file.resolve().parent if file else Path.cwd()
        if mjcf.is_relative_to(folder):
            mjcf = mjcf.relative_to(folder)
        for name, value in (self.fields | given | {"mjcf": mjcf.as_posix()}).items():
            lines.append(f"{name} = {_toml(value)}")
        if "joint_map" not in self.fields:
            marks = dict.fromkeys(self.robot.held_joints, "# ") | dict.fromkeys(
                self.robot.joints, ""
            )
            lines += ["", *JOINT_MAP]
            for name in (*self.robot.joints, *self.robot.held_joints):
                key = json.dumps(name)
                lines.append(f"{marks[name]}{key} = {{name = {key}, {UNCHANGED}}}")
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
    joints = overrides.get("joints", [])
    if not isinstance(joints, list):
        raise UserError(f"joints must be a list of names, got {joints!r}.")
    if not joints or not {"tcp_site", "tcp_body"} & set(overrides):
        gripper = find_gripper(model, joints)
        values |= {"joints": list(gripper.joints), **gripper.fields}
        how["arm"] = gripper.how
    if "tcp_site" in overrides and "tcp_body" not in overrides:
        values = {k: v for k, v in values.items() if not k.startswith("tcp_")}
    values |= overrides
    values.setdefault("home", _rest(model, values["joints"]))
    scene = _wide_scene(path, values | NO_RECTANGLE, targets)
    if not BASE_FIELDS & set(overrides):
        root = model.body_rootid[model.joint(values["joints"][0]).bodyid[0]]
        free = mujoco.mjtJoint.mjJNT_FREE in model.jnt_type[model.jnt_bodyid == root]
        values |= (base := place_base(scene, free))
        if base:
            how["base"] = "turned or shifted so that the arm stands at the origin and faces x"
    x, y, z = _robot(path, NO_RECTANGLE | WIDE_VIEW | values).base_position_m

    @cache  # compiling many meshes takes seconds
    def scene_at(height: float) -> Scene:
        base = {"base_position_m": [x, y, height]}
        return _wide_scene(path, values | NO_RECTANGLE | base, targets)

    try:
        low = lowest_fixed_m(scene_at(z))
        changes = [each for each in HEIGHTS_M if each >= 0 or low + each > 0]
        heights = (z,) if BASE_FIELDS & set(overrides) else [z + each for each in changes]
        layout = find_layout(scene_at, heights, overrides)
    except UserError as error:
        tried = "; ".join(f"{topic}: {text}" for topic, text in how.items())
        raise UserError(f"{error} Tried: {tried or 'the given joints and TCP'}.") from None
    scene, angle, roll = layout.scene, layout.angle_deg, layout.ignore_roll
    half_range = np.median(scene.joint_upper - scene.joint_lower) / 2
    values.setdefault("start_fraction", min(Robot.start_fraction, round(START_RAD / half_range, 3)))
    values["base_position_m"] = _numbers(scene.robot.base_position_m)
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
    homes = [Home(scene.home, 0.0, "")] if "home" in overrides else find_homes(scene, layout)
    values.setdefault("camera_fovy_deg", FOVY_DEG)
    home, view, how["camera"] = choose_view(scene, homes, values)
    if "home" not in overrides:
        values["home"], how["home"] = _numbers(home.joints), home.text
        values.setdefault("mpi_rad", round(home.travel / STEPS, 3))
        steps = home.travel / values["mpi_rad"]
        how["actions"] = f"{steps:.0f} steps of mpi_rad to the farthest grasp"
    values = view | values
    lag = servo_lag(scene := _wide_scene(path, values, targets))
    if lag >= MAX_LAG_RAD and "servo_frequency_hz" not in overrides:
        values["servo_frequency_hz"], best = best_frequency(scene)
        how["servos"] = f"{best:.4f} rad from their targets; {lag:.4f} rad at the usual 7 Hz"
    robot = _robot(path, values)
    size_m = float(np.linalg.norm(robot.rectangle_half_size_m))
    most_m = EVALUATION_M if angle <= EASY_DEG else EnvConfig.success_distance_m
    draft = Draft(
        robot=robot,
        fields=values,
        how=how,
        success_angle_deg=angle,
        ignore_roll=roll,
        distance_m=min(most_m, max(LEAST_M, round(SCALE * size_m, 2))),
    )
    for skill in SKILLS.types() if robot.fingers and not robot.areas else ():
        if skill.moves_fingers:
            area, how[skill.area] = find_area(robot, draft.toml, skill())
            values |= {"areas": {skill.area: area}} if area else {}
    return draft


def shrink_distance(draft: Draft, targets: Sequence[str]) -> Draft:
    """Shrink a draft's distance of success until a fixed list of actions solves little enough."""
    angle, roll = draft.success_angle_deg, draft.ignore_roll
    with TemporaryDirectory() as folder:
        (file := Path(folder) / "arm.toml").write_text(draft.toml(file), "utf-8")
        config = EnvConfig(
            robot=str(file), targets=tuple(targets), success_angle_deg=angle, ignore_roll=roll
        )
        distance_m = draft.distance_m
        while (share := fixed_list_success(config, distance_m)[0]) > WANTED_BLIND:
            if distance_m <= LEAST_M:
                break
            distance_m = max(LEAST_M, round(SHRINK * distance_m / STEP_M) * STEP_M)
    solved = f"the best fixed list of actions solves {100 * share:.0f} %"
    how = draft.how | {"success": f"within {100 * distance_m:g} cm, where {solved}"}
    return replace(draft, distance_m=distance_m, how=how)


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
