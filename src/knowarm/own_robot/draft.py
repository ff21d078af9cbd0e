"""Draft of a robot's description from a bare MJCF file: start pose, rectangle, yaws, camera."""

import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from mujoco import MjModel, mjtJoint
from numpy.linalg import norm

from knowarm.config import from_dict
from knowarm.errors import UserError, unknown_name
from knowarm.own_robot.calibration import joint_map_toml, unit_map
from knowarm.own_robot.draft_base import lowest_m, place_base
from knowarm.own_robot.draft_gripper import find_gripper
from knowarm.own_robot.draft_home import STEPS, Home, find_homes
from knowarm.own_robot.draft_reach import Layout, find_layout, spread_rad
from knowarm.own_robot.draft_view import FOVY_DEG, choose_view
from knowarm.own_robot.grasp_check import MIN_TAUGHT, area_skills
from knowarm.own_robot.object_check import MIN_ORACLE, oracle_success
from knowarm.own_robot.pixels import fixed_parts
from knowarm.own_robot.plausible import question_ranges, ranges_of
from knowarm.own_robot.poses import Fields, rounded
from knowarm.own_robot.robot_check import EVALUATION_M, MAX_BLIND, fixed_list_success
from knowarm.own_robot.servo_check import MAX_LAG_RAD, best_frequency, servo_lag
from knowarm.reading import one_line
from knowarm.world.agents.scripted import TeacherAgent
from knowarm.world.config import SUCCESS_DISTANCE_M, EnvConfig
from knowarm.world.objects import find_targets
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.mjcf import read_mjcf
from knowarm.world.scene.scene import Scene, build_scene
from knowarm.world.tasks.reward import SUCCESS_ANGLE_DEG
from knowarm.world.tasks.skills.skill import Skill
from knowarm.world.tasks.task import Task

HEIGHTS_M = (0.0, 0.2, 0.4, 0.6, -0.2, -0.4, -0.6)
"""Changes of the base's height that are tried, of which it must stay above the floor [m]."""

BASE_FIELDS = {"base_position_m", "base_yaw_deg", "table"}
"""Fields that say where the base is; if one is given, no other place is searched."""

SCALE = 0.35
"""Distance of success in an evaluation relative to half the diagonal of the rectangle, at most
`EVALUATION_M`: a small arm is not tested with thresholds that a fixed list of actions meets."""

EASY_DEG = 30.0
"""Angle above which that distance is at most that of the task: so for an arm of few joints."""

LEAST_M = 0.02  # Least distance of success
STEP_M = 0.005  # It is a multiple of this
SHRINK = 0.7  # Factor by which it shrinks while a fixed list of actions solves too much
WANTED_BLIND = MAX_BLIND - 0.1  # Success of the list from which it stays
START_RAD = 0.4
"""Largest offset of a joint of median range at the start: as of the shipped robots [rad]."""

JOINT_MAP = """
# The real arm, for knowarm serve, ros, record and export, in its order: value = sign * scale
# * angle + offset, in the unit: "rad", "deg", or LeRobot's "range_0_100" and "range_m100_100",
# whose ends are the model's limits or range = [-1.9, 1.9]. knowarm doctor --calibration fills it.
"""
"""Comment above a drafted joint map, which converts nothing; held joints are sent if named."""

NO_RECTANGLE = {
    "rectangle_centre_m": [0.0, 0.0],
    "rectangle_half_size_m": [0.0, 0.0],
    "target_yaw_deg": 0.0,
    "target_yaws_deg": {},
}
WIDE_VIEW = {
    "camera_position_m": [20.0, -20.0, 20.0],
    "camera_look_at_m": [0.0, 0.0, 0.0],
    "camera_fovy_deg": 60.0,
}
"""A view in which everything is visible."""


Choices = dict[str, str]
"""What was chosen and why, by topic."""


@dataclass(frozen=True, kw_only=True)
class Draft:
    """A drafted description and how it was found."""

    robot: Robot  # The description
    fields: Fields  # Its fields as they are written to TOML
    how: Choices  # How they were found
    success_angle_deg: float  # Orientation tolerance of the task that it can do [deg]
    ignore_roll: bool  # Whether that task ignores the rotation about the approach axis
    distance_m: float  # Distance within which an evaluation counts success [m]

    @property
    def thresholds(self) -> Fields:
        """The thresholds of success that differ from the usual ones, as fields."""
        fields: Fields = {}
        if self.distance_m < SUCCESS_DISTANCE_M:
            fields["success_distance_m"] = self.distance_m
        if self.success_angle_deg != SUCCESS_ANGLE_DEG:
            fields["success_angle_deg"] = self.success_angle_deg
        if self.ignore_roll:
            fields["ignore_roll"] = True
        if self.distance_m < EVALUATION_M:
            fields["evaluation_distance_m"] = self.distance_m
        return fields

    def toml(self, file: Path | None = None, **given: Any) -> str:
        """Return the description as TOML, with ``mjcf`` relative to its file if that works.

        ``given`` replaces fields of the description.
        """
        lines = [f"# {topic}: {text}" for topic, text in self.how.items()]
        mjcf = self.robot.mjcf.resolve()
        folder = file.resolve().parent if file else Path.cwd()
        if mjcf.is_relative_to(folder):
            mjcf = mjcf.relative_to(folder)
        values = self.thresholds | self.fields | given
        values["mjcf"] = mjcf.as_posix()
        lines += [f"{name} = {_toml(value)}" for name, value in values.items()]
        text = "\n".join(lines) + "\n"
        if "joint_map" not in self.fields:
            text += JOINT_MAP + joint_map_toml(unit_map(self.robot.joints, "rad"))
            held = joint_map_toml(unit_map(self.robot.held_joints, "rad"))
            for line in held.splitlines()[1:]:
                text += f"# {line}\n"
        return text


@contextmanager
def written(draft: Draft, **given: Any) -> Iterator[str]:
    """Write a draft to a temporary file, with fields that are given, and return its name."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "arm.toml"
        file.write_text(draft.toml(file, **given), "utf-8")
        yield str(file)


def _toml(value: Any) -> str:
    """Write a value in TOML's notation, mappings as inline tables."""
    if isinstance(value, Mapping):
        items = [f"{json.dumps(key)} = {_toml(item)}" for key, item in value.items()]
        return f"{{{', '.join(items)}}}"
    return json.dumps(value)


def read_overrides(settings: Sequence[str]) -> Fields:
    """Read settings of the form ``field=value`` in TOML's notation."""
    values: Fields = {}
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


def draft_robot(path: Path, targets: Sequence[str], overrides: Fields) -> Draft:
    """Draft the description of the arm in an MJCF file, which should reach objects.

    Targets are names or TOML files; overrides are fields of ``Robot`` that are not drafted.
    """
    how: Choices = {}
    model = read_mjcf(path, str(path)).compile()
    values: Fields = {"mjcf": str(path)} | _arm(model, overrides, how)

    def build(changes: Fields) -> Scene:
        """Build a scene in which everything is visible, to compute with."""
        robot = _robot(path, values | WIDE_VIEW | changes)
        return build_scene(robot, find_targets(targets))

    scene = build(NO_RECTANGLE)
    question, ranges = question_ranges(scene)
    if question:
        raise UserError(f"{path.name}: {question}, such as --set '{ranges}'.")
    is_placed = not BASE_FIELDS.isdisjoint(overrides)
    if not is_placed:
        base = place_base(scene, _is_free(model, values["joints"][0]))
        values |= base
        if base:
            how["base"] = (
                "turned or shifted so that the arm stands at the origin, on the floor where its "
                "table is left out, and faces x"
            )
    x, y, z = values.get("base_position_m", Robot.base_position_m)

    @cache  # compiling many meshes takes seconds
    def scene_at(height: float) -> Scene:
        return build(NO_RECTANGLE | {"base_position_m": [x, y, height]})

    try:
        heights = [z]
        if not is_placed:
            low = lowest_m(scene_at(z), fixed_parts(scene_at(z)))
            changes = [
                change for change in HEIGHTS_M if change >= 0 or low + change > 0
            ]
            heights = [z + change for change in changes]
        layout = find_layout(scene_at, heights, overrides)
    except UserError as error:
        tried = "; ".join(f"{topic}: {text}" for topic, text in how.items())
        raise UserError(
            f"{error} Tried: {tried or 'the given joints and TCP'}."
        ) from None
    _add_rectangle(layout, values, how)
    values = _view(build({}), layout, values, how, "home" in overrides)
    scene = build({})
    lag = servo_lag(scene)
    if lag >= MAX_LAG_RAD and "servo_frequency_hz" not in overrides:
        values["servo_frequency_hz"], best = best_frequency(scene)
        how["servos"] = (
            f"{best:.4f} rad from their targets; {lag:.4f} rad at the usual 7 Hz"
        )
    robot = _robot(path, values)
    distance_m = round(SCALE * float(norm(robot.rectangle_half_size_m)), 2)
    most_m = EVALUATION_M
    if layout.angle_deg > EASY_DEG:
        most_m = SUCCESS_DISTANCE_M
    draft = Draft(
        robot=robot,
        fields=values,
        how=how,
        success_angle_deg=layout.angle_deg,
        ignore_roll=layout.ignore_roll,
        distance_m=min(most_m, max(LEAST_M, distance_m)),
    )
    if robot.fingers and not robot.areas:
        for skill in area_skills(robot):
            area, how[skill.area] = find_area(draft, skill)
            if area:
                values["areas"] = {skill.area: area}
    return draft


def _robot(path: Path, values: Fields) -> Robot:
    fields = {"name": path.stem, **values, "mjcf": path}
    return from_dict(Robot, fields, where=str(path))


def _arm(model: MjModel, overrides: Fields, how: Choices) -> Fields:
    """Return the fields of arm and TCP, and all that are given."""
    values: Fields = {}
    joints = overrides.get("joints", [])
    if not isinstance(joints, list):
        raise UserError(f"joints must be a list of names, got {joints!r}.")
    if not joints or overrides.keys().isdisjoint({"tcp_site", "tcp_body"}):
        gripper = find_gripper(model, joints)
        values = {"joints": list(gripper.joints), **gripper.fields}
        how["arm"] = gripper.how
    if "tcp_site" in overrides and "tcp_body" not in overrides:
        for name in ("tcp_body", "tcp_position_m", "tcp_quaternion"):
            values.pop(name, None)
    values |= overrides
    ranges = ranges_of(model, values.get("joint_ranges", {}))
    rest = []
    for name in values["joints"]:
        low, high = ranges.get(name, (0.0, 0.0))
        rest.append(0.0 if low <= 0 <= high else (low + high) / 2)
    values.setdefault("home", rounded(rest))
    return values


def _is_free(model: MjModel, joint: str) -> bool:
    """Return whether the body on which all others before a joint hang moves freely."""
    root = model.body_rootid[model.joint(joint).bodyid[0]]
    return mjtJoint.mjJNT_FREE in model.jnt_type[model.jnt_bodyid == root]


def _add_rectangle(layout: Layout, values: Fields, how: Choices) -> None:
    """Add the fields of a layout that are not given."""
    scene = layout.scene
    half_range = np.median(scene.joint_upper - scene.joint_lower) / 2
    fraction = min(Robot.start_fraction, round(START_RAD / half_range, 3))
    values.setdefault("start_fraction", fraction)
    values["base_position_m"] = rounded(scene.robot.base_position_m)
    values.setdefault("rectangle_centre_m", rounded(layout.centre_m))
    values.setdefault("rectangle_half_size_m", rounded(layout.half_size_m))
    yaws = [branch.yaw_deg for branch in layout.branches]
    usual = values.setdefault("target_yaw_deg", max(set(yaws), key=yaws.count))
    others = {}
    for target, yaw in zip(scene.targets, yaws, strict=True):
        if yaw != usual:
            others[target.name] = yaw
    if others:
        values.setdefault("target_yaws_deg", others)
    roll = ", any roll" if layout.ignore_roll else ""
    how["rectangle"] = (
        f"in reach of all targets within {layout.angle_deg:.0f} degrees{roll}, with "
        f"the base at {scene.robot.base_position_m[2]:.2f} m; joints differ by at most "
        f"{spread_rad(layout.branches):.2f} rad between the grasps"
    )


def _view(
    scene: Scene,
    layout: Layout,
    values: Fields,
    how: Choices,
    is_home_given: bool,
) -> Fields:
    """Return the fields with those of camera and start pose before or among them."""
    homes = [Home(scene.home, 0.0, "")] if is_home_given else find_homes(scene, layout)
    values.setdefault("camera_fovy_deg", FOVY_DEG)
    home, view, how["camera"] = choose_view(scene, homes, values)
    if not is_home_given:
        values["home"] = rounded(home.joints)
        how["home"] = home.text
        step = values.setdefault("mpi_rad", round(home.travel / STEPS, 3))
        how["actions"] = (
            f"{home.travel / step:.0f} steps of mpi_rad to the farthest grasp"
        )
    return view | values


ENOUGH = MIN_ORACLE + 0.1  # Success of the teacher from which no other area is tried


def find_area(draft: Draft, skill: Skill) -> tuple[Fields, str]:
    """Find the area, of those that a skill proposes, in which its teacher succeeds most often.

    What two fingers do with an object depends on their contacts, which inverse kinematics does not
    see. Return the fields of the area, empty if nothing can be done, and what was found.
    """
    best = 0.0
    best_area: Fields = {}
    for area in skill.areas_to_try(draft.robot):
        with written(draft, areas={skill.area: area}) as file:
            try:
                config = EnvConfig(robot=file, task=Task(skill=skill))
                success = oracle_success(config, TeacherAgent)
            except UserError as error:
                return {}, f"not possible: {error}"
        if success > best:
            best = success
            best_area = area
        if best >= ENOUGH:
            break
    if best < MIN_TAUGHT:
        return {}, (
            f"no area: the teacher succeeds in at most {100 * best:.0f} % of the episodes in those "
            "that were tried"
        )
    found = f"the teacher succeeds in {100 * best:.0f} % of the episodes in its area"
    return best_area, found


def shrink_distance(draft: Draft, targets: Sequence[str]) -> Draft:
    """Shrink a draft's distance of success until a fixed list of actions solves little enough."""
    distance_m = draft.distance_m
    with written(draft) as file:
        config = EnvConfig(robot=file, targets=tuple(targets))
        share, _ = fixed_list_success(config, distance_m)
        while share > WANTED_BLIND and distance_m > LEAST_M:
            distance_m = max(LEAST_M, round(SHRINK * distance_m / STEP_M) * STEP_M)
            share, _ = fixed_list_success(config, distance_m)
    success = (
        f"within {100 * distance_m:g} cm, where the best fixed list of actions solves "
        f"{100 * share:.0f} %"
    )
    return replace(draft, distance_m=distance_m, how=draft.how | {"success": success})
