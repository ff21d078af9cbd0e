"""From an arm's file and calibration to targets in its maker's units, by independent arithmetic."""

import csv
import json
import math
import tomllib
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from knowarm.config import from_dict
from knowarm.deploy.contract import deployment
from knowarm.deploy.joint_map import real_joints
from knowarm.deploy.runner import JointMap, Start
from knowarm.errors import UserError
from knowarm.own_robot import command
from knowarm.own_robot.calibration import (
    Motor,
    joint_map_toml,
    lerobot_map,
    motor_names,
    narrower_ranges,
    read_calibration,
    unit_map,
)
from knowarm.own_robot.command import Doctor
from knowarm.own_robot.moved_joints import check_moved_joints
from knowarm.own_robot.plausible import ranges_of
from knowarm.own_robot.urdf import as_mjcf
from knowarm.world.backend import MujocoSimulator
from knowarm.world.objects import find_targets
from knowarm.world.robots import ROBOTS, find_robot
from knowarm.world.robots.robot import RealJoint
from knowarm.world.scene.scene import build_scene, load_scene
from tests.own_robot.robot_cases import as_urdf
from tests.world.helpers import EXAMPLES

LIMITS = {
    "shoulder_pan": (-1.91986, 1.91986),
    "shoulder_lift": (-1.74533, 1.74533),
    "elbow_flex": (-1.69, 1.69),
    "wrist_flex": (-1.65806, 1.65806),
    "wrist_roll": (-2.74385, 2.84121),
    "gripper": (-0.174533, 1.74533),
}
"""Limits of an SO-101's model [rad]."""

UNITS = [
    {
        "shoulder_pan": (748, 3410),
        "shoulder_lift": (837, 3341),
        "elbow_flex": (793, 2995),
        "wrist_flex": (910, 3277),
        "wrist_roll": (0, 4095),
        "gripper": (2030, 3500),
    },
    {
        "shoulder_pan": (738, 3446),
        "shoulder_lift": (876, 3222),
        "elbow_flex": (899, 3110),
        "wrist_flex": (819, 3124),
        "wrist_roll": (150, 3900),
        "gripper": (1990, 3444),
    },
]
"""Ticks of two SO-101 as they were calibrated."""


def write_calibration(path: Path, ticks: dict, **changes: object) -> Path:
    motors = {}
    for number, (name, (low, high)) in enumerate(ticks.items(), start=1):
        motors[name] = {
            "id": number,
            "drive_mode": 0,
            "homing_offset": 37,
            "range_min": low,
            "range_max": high,
        } | changes
    path.write_text(json.dumps(motors))
    return path


def scene_like(limits: dict, joint_map: dict):
    """Return a stand-in for a scene whose joints are those of an arm without its gripper."""
    joints = "".join(
        f'<body><joint name="{name}" range="{low} {high}"/><geom size=".1"/></body>'
        for name, (low, high) in limits.items()
    )
    text = f'<mujoco><compiler angle="radian"/><worldbody>{joints}</worldbody></mujoco>'
    names = tuple(name for name in limits if name != "gripper")
    return text, names


@pytest.fixture
def so101(tmp_path):
    """Return a function that gives the entries of the contract for a joint map of an SO-101."""
    text, names = scene_like(LIMITS, {})
    (tmp_path / "so101.xml").write_text(text)
    model = mujoco.MjModel.from_xml_string(text)

    def entries(joint_map: dict) -> list[dict]:
        real = {
            name: from_dict(RealJoint, fields) for name, fields in joint_map.items()
        }
        robot = replace(
            ROBOTS["irb120"],
            mjcf=tmp_path / "so101.xml",
            joints=names,
            home=(0.0,) * 5,
            areas={},
            held_joints={"gripper": 1.0},
            joint_map=real,
        )
        ranges = np.array([LIMITS[name] for name in names])
        scene = type("Stub", (), {"fingers": None})()
        scene.robot = robot
        scene.joint_names = names
        scene.joint_lower, scene.joint_upper = ranges.T
        scene.model = model
        scene.qpos_index = range(5)
        return real_joints(scene)

    return entries


def ticks_of(unit: str, value: float, low: int, high: int) -> float:
    """Return what LeRobot sends a motor for a value, without its rounding."""
    if unit == "deg":
        return value * 4095 / 360 + (low + high) / 2
    if unit == "range_0_100":
        return value / 100 * (high - low) + low
    return (value + 100) / 200 * (high - low) + low


@pytest.mark.parametrize("ticks", UNITS)
@pytest.mark.parametrize("unit", ["range", "deg"])
def test_targets_of_an_so101_reach_the_angles_of_the_model(
    unit: str, ticks: dict, so101, tmp_path: Path
) -> None:
    motors = read_calibration(write_calibration(tmp_path / "arm.json", ticks))
    ranges = {name: np.array(ends) for name, ends in LIMITS.items()}
    entries = so101(lerobot_map(motors, ranges, {}, unit))
    joint_map = JointMap({"names": [*LIMITS][:5], "real": entries})
    assert joint_map.names == tuple(f"{name}.pos" for name in LIMITS)
    generator = np.random.default_rng(0)
    lower, upper = np.array([LIMITS[name] for name in [*LIMITS][:5]]).T
    angles = generator.uniform(lower, upper, (50, 5))
    for row, values in zip(angles, joint_map.to_real(angles), strict=True):
        for j, (name, angle) in enumerate(zip(LIMITS, row, strict=False)):
            low, high = ticks[name]
            kind = "deg" if unit == "deg" else "range_m100_100"
            raw = ticks_of(kind, values[j], low, high)
            # The encoder has 4096 ticks per turn; the model is at 0 in the middle of the range.
            middle = (low + high) / 2
            zero = 0.0
            if name == "wrist_roll" and high - low < 4095:
                zero = sum(LIMITS[name]) / 2
            turned = (raw - middle) * 2 * math.pi / 4096 + zero
            assert math.degrees(abs(turned - angle)) < 0.05
    # The gripper stays at 1 rad from the closed end of -.1745.
    low, high = ticks["gripper"]
    raw = ticks_of("range_0_100", values[-1], low, high)
    opened = (raw - low) * 2 * math.pi / 4096
    assert math.degrees(abs(opened - 1.174533)) < 0.5


def test_the_models_limits_in_place_of_the_calibration_are_degrees_off(so101) -> None:
    plain = {name: {"unit": "range_m100_100"} for name in LIMITS}
    entry = so101(plain)[0]
    at_limit = entry["scale"] * 1.91986 + entry["offset"]
    raw = ticks_of("range_m100_100", at_limit, 748, 3410)
    turned = (raw - (748 + 3410) / 2) * 360 / 4096
    assert abs(turned - math.degrees(1.91986)) > 6


def test_an_inverted_motor_counts_as_lerobot_corrects_it(so101, tmp_path: Path) -> None:
    path = write_calibration(tmp_path / "arm.json", UNITS[0], drive_mode=1)
    ranges = {name: np.array(ends) for name, ends in LIMITS.items()}
    entry = so101(lerobot_map(read_calibration(path), ranges, {}))[0]
    low, high = UNITS[0]["shoulder_pan"]
    value = entry["scale"] * 0.5 + entry["offset"]
    # Feetech: the normalized value is negated, and ticks fall where the joint turns forward.
    raw = (-value + 100) / 200 * (high - low) + low
    turned = -(raw - (low + high) / 2) * 2 * math.pi / 4096
    assert turned == pytest.approx(0.5, abs=1e-4)


SOFT = (
    '<limit lower="-2.9671" upper="2.9671" effort="80" velocity="3"/>'
    '<safety_controller soft_lower_limit="-2.8973" soft_upper_limit="2.8973"/>'
)


@pytest.mark.parametrize(
    ("unit", "per_rad"), [("rad", 1.0), ("deg", 180 / math.pi)], ids=["franka", "xarm"]
)
def test_arms_of_one_unit_are_sent_no_target_beyond_their_soft_limits(
    unit: str, per_rad: float, tmp_path: Path
) -> None:
    (tmp_path / "arm.urdf").write_text(as_urdf(limit=SOFT))
    file, _ = as_mjcf(tmp_path / "arm.urdf", tmp_path / "out")
    names = tuple(f"j{i}" for i in range(1, 7))
    fields = {
        name: from_dict(RealJoint, entry)
        for name, entry in unit_map(names, unit).items()
    }
    robot = replace(
        ROBOTS["irb120"],
        mjcf=file,
        joints=names,
        tcp_body="l6",
        home=(0.0,) * 6,
        fingers=(),
        areas={},
        held_joints={},
        camera_position_m=(2.0, -2.0, 1.5),
        camera_fovy_deg=60.0,
        joint_map=fields,
    )
    scene = build_scene(robot, find_targets(["mug"]))
    joint_map = JointMap({"names": names, "real": real_joints(scene)})
    np.testing.assert_allclose(
        joint_map.to_real(np.array([scene.joint_upper]))[0], 2.8973 * per_rad
    )
    angles = np.array([[0.1, -0.2, 0.3, 1.0, -1.0, 2.0]])
    degrees = joint_map.to_real(angles)[0] / per_rad * 180 / math.pi
    assert np.abs(degrees - np.degrees(angles[0])).max() < 0.5


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (
            {"shoulder": {"range_min": 1, "range_max": 900}},
            "motors shoulder, which are no",
        ),
        ({"shoulder_pan": {"range_min": 9, "range_max": 1}}, "the lower one first"),
        ({"shoulder_pan": {"range_min": 9, "range_max": 9}}, "the lower one first"),
        ({"shoulder_pan": {"range_min": -1, "range_max": 9}}, "must lie in 0 to 4095"),
        ({}, "has no motors. Give the JSON file that LeRobot"),
        (
            {"shoulder_pan": {"range_min": 2047, "range_max": 2049}},
            "shoulder_pan was moved by 0.2 degrees when its range was recorded",
        ),
        (
            {"shoulder_pan": {"range_min": 7, "range_max": 2049, "drive_mode": 2}},
            "drive_mode '2'. Available: 0, 1",
        ),
        (
            {"shoulder_pan": {"range_min": 1, "range_max": 5000}},
            "must lie in 0 to 4095",
        ),
        ({"shoulder_pan": {"range_min": 1}}, "range_max"),
        (
            {"shoulder_pan": {"range_min": "a", "range_max": 9}},
            "range_min must be of ty",
        ),
        ({"homing_offset": [1, 2], "start_pos": [1]}, "LeRobot before 0.3 lack it"),
        ({"shoulder_pan": {"range_min": 1, "range_max": 9, "x": 1}}, "field of"),
    ],
)
def test_calibrations_that_cannot_be_are_refused(
    values: dict, words: str, tmp_path: Path
) -> None:
    (tmp_path / "arm.json").write_text(json.dumps(values))
    ranges = {name: np.array(ends) for name, ends in LIMITS.items()}
    with pytest.raises(UserError, match=words):
        lerobot_map(read_calibration(tmp_path / "arm.json"), ranges, {})


def test_motors_of_other_names_are_those_that_the_joint_map_names() -> None:
    joint_map = {"Rotation": RealJoint(name="shoulder_pan.pos"), "Pitch": RealJoint()}
    motors = {"shoulder_pan": Motor(range_min=100, range_max=3000)}
    ranges = {"Rotation": np.array([-2.0, 2.0]), "Pitch": np.array([-1.0, 1.0])}
    entries = lerobot_map(motors, ranges, motor_names(joint_map))
    assert [*entries] == ["Rotation"]
    assert entries["Rotation"]["name"] == "shoulder_pan.pos"


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"scale": 0.0}, "scale must be positive"),
        ({"scale": -1.0}, "scale must be positive.*sign = -1"),
        ({"unit": "range_0_100", "range": [1.0, 0.0]}, "the lower end first"),
        ({"unit": "deg", "range": [0.0, 1.0]}, "of the units range_0_1"),
    ],
)
def test_scales_and_ranges_that_cannot_be_are_refused(fields: dict, words: str) -> None:
    with pytest.raises(UserError, match=words):
        from_dict(RealJoint, fields)


def test_doctor_writes_the_map_of_a_description_and_serve_reads_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch
) -> None:
    robot = ROBOTS["irb120"]
    ticks = dict.fromkeys(robot.joints, (1000, 3000))
    calibration = write_calibration(tmp_path / "arm.json", ticks)
    new = tmp_path / "map.toml"
    monkeypatch.setattr("knowarm.own_robot.command.check_robot", lambda *a, **o: [])
    Doctor(robot="irb120", calibration=calibration, write=new).run()
    assert f"--joint-map {new}" in capsys.readouterr().out
    scene = load_scene("irb120", ("mug",))
    entry = real_joints(scene, new)[0]
    half = 1000 * 2 * math.pi / 4096
    assert entry["name"] == "joint_1.pos"
    middle = (scene.joint_lower[0] + scene.joint_upper[0]) / 2
    at_end = entry["scale"] * (middle + half) + entry["offset"]
    assert at_end == pytest.approx(100, abs=1e-2)
    with pytest.raises(UserError, match="file that does not exist"):
        Doctor(robot="irb120", calibration=calibration, write=new).run()
    with pytest.raises(UserError, match="LeRobot counts in no radians"):
        Doctor(robot="irb120", calibration=calibration, unit="rad").run()
    with pytest.raises(UserError, match="--unit must be rad or deg here"):
        Doctor(robot="irb120", unit="range").run()
    with pytest.raises(UserError, match="--calibration needs --robot"):
        Doctor(calibration=calibration).run()
    Doctor(robot="irb120", unit="deg").run()
    line = '"joint_1" = {name = "joint_1", sign = 1, offset = 0.0, unit = "deg"}'
    assert line in capsys.readouterr().out


class OwnArm:
    """Arm of the example, simulated, whose controller counts each joint in units of its own."""

    def __init__(self, units: dict[str, tuple[float, float]]) -> None:
        self.scene = load_scene(str(EXAMPLES / "scara.toml"), ("bottle",))
        self.simulation = MujocoSimulator(self.scene, 1)
        self.units = (
            units  # what a radian or metre is, and what it reads at the model's 0
        )
        self.simulation.set_joints(self.scene.home[None])

    def drive(self, values: list[float]) -> None:
        targets = []
        for name, value in zip(self.scene.joint_names, values, strict=True):
            factor, zero = self.units[name]
            targets.append((value - zero) / factor)
        for _ in range(20):
            self.simulation.step(np.array([targets]))

    def encoders(self) -> np.ndarray:
        """Return what its encoders read: degrees, for slides metres."""
        angles = self.simulation.joint_positions[0].copy()
        slides = self.scene.model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
        addresses = self.scene.model.jnt_qposadr[slides]
        turns = ~np.isin(self.scene.qpos_index, addresses)
        angles[turns] = np.degrees(angles[turns])
        return angles


def move_each_joint(arm: OwnArm, robot_file: Path, out: Path) -> None:
    """Move each joint through the joint map of a description, as a person would; write a CSV."""
    scene = load_scene(str(robot_file), ("bottle",))
    joint_map = JointMap({"names": scene.joint_names, "real": real_joints(scene)})
    rows = []
    for j, name in enumerate(scene.joint_names):
        # From the middle, so that no limit is in the way
        start = (scene.joint_lower + scene.joint_upper) / 2
        slide = (
            scene.model.joint(f"robot/{name}").type[0] == mujoco.mjtJoint.mjJNT_SLIDE
        )
        arm.drive(joint_map.to_real(start[None])[0].tolist())
        before = arm.encoders()[j]
        start[j] += 0.01 if slide else math.radians(5)
        arm.drive(joint_map.to_real(start[None])[0].tolist())
        unit = "m" if slide else "deg"
        rows.append((name, before, arm.encoders()[j], unit))
    with out.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["joint", "before", "after", "unit"])
        writer.writerows(rows)


def describe_example(folder: Path, joint_map: dict) -> Path:
    text = (EXAMPLES / "scara.toml").read_text()
    text = text.replace('"scara.xml"', f'"{EXAMPLES / "scara.xml"}"')
    file = folder / "arm.toml"
    file.write_text(f"{text}\n{joint_map_toml(joint_map)}")
    return file


DEG = math.degrees(1)


def test_five_degrees_of_each_joint_of_a_simulated_arm(tmp_path: Path) -> None:
    names = find_robot(str(EXAMPLES / "scara.toml")).joints
    out = tmp_path / "moved.csv"
    arm = OwnArm(dict.fromkeys(names, (DEG, 0.0)))
    right = {name: {"unit": "deg"} for name in names}
    hinge = names[0]
    file = describe_example(tmp_path, right)
    scene = load_scene(str(file), ("bottle",))
    for name in names:
        joint = scene.model.joint(f"robot/{name}")
        if joint.type[0] == mujoco.mjtJoint.mjJNT_SLIDE:
            arm.units[name] = (1.0, 0.0)
            right[name] = {"unit": "rad"}
    file = describe_example(tmp_path, right)
    move_each_joint(arm, file, out)
    checks = [*check_moved_joints(str(file), out)]
    assert len(checks) == 1 + len(names)
    assert [check for check in checks if not check.ok] == []

    wrong = right | {hinge: {"unit": "deg", "scale": 1.065}}
    file = describe_example(tmp_path, wrong)
    move_each_joint(arm, file, out)
    (failed,) = [check for check in check_moved_joints(str(file), out) if not check.ok]
    assert failed.name == f"joint {hinge}"
    scale = float(failed.remedy.split(".scale = ")[1].split(",")[0])
    file = describe_example(tmp_path, right | {hinge: {"unit": "deg", "scale": scale}})
    move_each_joint(arm, file, out)
    assert all(check.ok for check in check_moved_joints(str(file), out))

    # LeRobot's unit: the arm's range is 6 % wider than the model's.
    low, high = scene.joint_lower[0], scene.joint_upper[0]
    half = 1.06 * (high - low) / 2
    middle = (low + high) / 2
    arm.units[hinge] = (100 / half, -100 * middle / half)
    file = describe_example(tmp_path, right | {hinge: {"unit": "range_m100_100"}})
    move_each_joint(arm, file, out)
    (failed,) = [check for check in check_moved_joints(str(file), out) if not check.ok]
    ends = tomllib.loads("x = " + failed.remedy.split(".range = ")[1].rstrip("."))["x"]
    np.testing.assert_allclose(ends, [middle - half, middle + half], rtol=0.02)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (
            "joint,before,after,unit\nshoulder,0,-5,deg\n",
            "It moves the other way: joint_map.shoulder.sign = -1",
        ),
        ("joint,before,after,unit\nshoulder,0,0.01,deg\n", "It did not move"),
        ("joint,before,after,unit\nshoulder,100,157,ticks\n", ""),
        ("joint,before,after,unit\nshoulder,0,0.0873,rad\n", ""),
        ("joint,before,after,unit\nshoulder,0,4,deg\nshoulder,0,6,deg\n", ""),
    ],
)
def test_readings_in_the_units_of_arms(rows: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "moved.csv").write_text(rows)
    robot = str(EXAMPLES / "scara.toml")
    checks = {c.name: c for c in check_moved_joints(robot, tmp_path / "moved.csv")}
    assert not checks["moved joints"].ok
    assert "Move the others too: " in checks["moved joints"].remedy
    assert checks["joint shoulder"].ok is (not words)
    if words:
        assert words in checks["joint shoulder"].remedy


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("joint,before,after,unit\n", "it has no rows"),
        ("joint,before\na,1\n", "Give the columns joint, before, after, unit"),
        ("joint,before,after,unit\nshoulder,0,x,deg\n", "Give the columns"),
        ("joint,before,after,unit\nshoulder,0,nan,deg\n", "no finite readings"),
        ("joint,before,after,unit\nshoulder,0,5,grad\n", "in a known unit"),
        ("joint,before,after,unit\nelbow9,0,5,deg\n", "names 'elbow9'"),
        ("joint,before,after,unit\nfingers,0,.01,m\n", "names 'fingers'"),
        ("joint,before,after,unit\nshoulder,0,.01,m\n", "turns, and m does not"),
        ("joint,before,after,unit\nlift,0,5,deg\n", "slides, and deg does not"),
    ],
)
def test_files_of_moved_joints_that_cannot_be_are_refused(
    text: str, words: str, tmp_path: Path
) -> None:
    (tmp_path / "moved.csv").write_text(text)
    with pytest.raises(UserError, match=words):
        Doctor(robot=str(EXAMPLES / "scara.toml"), joints=tmp_path / "moved.csv").run()


TIAGO = """joint,before,after,unit
{}
fingers,{},m
"""
TURNED = "\n".join(f"arm_{j}_joint,0,5,deg" for j in range(1, 8))


@pytest.mark.parametrize(
    ("entry", "reading", "remedy"),
    [
        ({}, "0,.01", None),
        ({}, "0,.012", "joint_map.fingers.scale = 0.8333"),
        ({"unit": "range_0_1"}, "0,.01", None),
        ({"unit": "range_0_1"}, "0,.012", "joint_map.fingers.range = [0.0, 0.0468]"),
        ({"unit": "range_0_1", "sign": -1, "offset": 1.0}, "0,.01", None),
        ({"sign": -1}, ".01,0", "joint_map.fingers.sign = 1, with the offset"),
        ({}, "0,0", "It did not move"),
    ],
)
def test_fingers_are_measured_as_they_close(
    entry: dict, reading: str, remedy: str | None, tmp_path: Path
) -> None:
    text = describe_tiago(entry)
    (tmp_path / "arm.toml").write_text(text)
    (tmp_path / "moved.csv").write_text(TIAGO.format(TURNED, reading))
    robot = str(tmp_path / "arm.toml")
    checks = [*check_moved_joints(robot, tmp_path / "moved.csv")]
    failed = [check for check in checks if not check.ok]
    assert len(checks) > 8
    if remedy is None:
        assert failed == []
        return
    (check,) = failed
    assert check.name == "joint fingers"
    assert remedy in check.remedy


def test_fingers_of_the_map_have_to_move_too(tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text(describe_tiago({}))
    rows = TIAGO.format(TURNED, "0,.01").splitlines()[:-1]
    (tmp_path / "moved.csv").write_text("\n".join(rows))
    first, *_ = check_moved_joints(str(tmp_path / "arm.toml"), tmp_path / "moved.csv")
    assert first.remedy == "Move the others too: fingers."


def describe_tiago(fingers: dict) -> str:
    """Return the description of the shipped TIAGo with a joint map that has fingers."""
    robot = ROBOTS["tiago"]
    text = robot.mjcf.with_suffix(".toml").read_text()
    text = text.replace('"tiago.xml"', json.dumps(str(robot.mjcf)))
    entries = {name: {} for name in robot.joints} | {"fingers": fingers}
    return f"{text}\n{joint_map_toml(entries)}"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"unit": "range"}, "--unit must be rad or deg here, got range"),
        ({"unit": "rad", "calibration": True}, "--unit must be range or deg here"),
        ({"camera": True, "unit": "deg"}, "--unit needs no --camera"),
        ({"camera": True, "joints": True}, "--joints needs no --camera"),
        ({"joints": True, "calibration": True}, "--calibration needs no --joints"),
    ],
)
def test_what_does_not_go_together_is_refused_before_a_draft(
    options: dict, words: str, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(command, "as_mjcf", None)
    for name, value in options.items():
        if value is True:
            options[name] = tmp_path / "file"
    (tmp_path / "arm.urdf").write_text(as_urdf())
    for robot in (str(tmp_path / "arm.urdf"), "irb120"):
        with pytest.raises(UserError, match=words):
            Doctor(robot=robot, **options).run()


def test_ranges_that_were_recorded_narrower_are_said(
    tmp_path: Path, monkeypatch, capsys
) -> None:
    """LeRobot cuts off targets beyond them."""
    ticks = dict(UNITS[1], elbow_flex=(1100, 3000), shoulder_pan=(900, 3398))
    span = 1900 * 2 * math.pi / 4096
    motors = read_calibration(write_calibration(tmp_path / "arm.json", ticks))
    ranges = {name: np.array(ends) for name, ends in LIMITS.items()}
    narrower = narrower_ranges(motors, ranges, {})
    assert narrower == {"elbow_flex": pytest.approx([-span / 2, span / 2], abs=1e-4)}
    # In between, the map is the same, so that what is sent stays within 100.
    entries = lerobot_map(motors, ranges | narrower, {}, "range")
    assert entries == lerobot_map(motors, ranges, {}, "range")
    assert entries["elbow_flex"]["range"] == pytest.approx(
        [-span / 2, span / 2], abs=1e-4
    )

    joint = ROBOTS["irb120"].joints[0]
    names = ROBOTS["irb120"].joints
    wide = dict.fromkeys(names[1:], (1, 4094)) | {joint: (1000, 3000)}
    monkeypatch.setattr("knowarm.own_robot.command.check_robot", lambda *a, **o: [])
    calibration = write_calibration(tmp_path / "other.json", wide)
    Doctor(robot="irb120", calibration=calibration).run()
    shown = capsys.readouterr().out
    assert f"joint_ranges = {{{joint} = [-1.534, 1.534]" in shown


def test_ranges_that_are_given_come_before_the_files() -> None:
    model = mujoco.MjModel.from_xml_string(scene_like(LIMITS, {})[0])
    ranges = ranges_of(model, {"gripper": [0.0, 1.0]})
    assert ranges["gripper"].tolist() == [0, 1]
    np.testing.assert_allclose(ranges["elbow_flex"], LIMITS["elbow_flex"])


@pytest.mark.parametrize("unit", ["range", "deg"])
def test_targets_of_a_policy_are_those_of_its_calibrated_arm(
    unit: str, trained, tmp_path: Path, monkeypatch
) -> None:
    """From a calibration file to what a deployed policy sends, in ticks of the motors."""
    joints = trained.config.env.robot
    names = ROBOTS[joints].joints
    generator = np.random.default_rng(3)
    ticks = {}
    for name in names:
        low = int(generator.integers(300, 1200))
        ticks[name] = (low, low + int(generator.integers(1800, 2700)))
    calibration = write_calibration(tmp_path / "arm.json", ticks)
    monkeypatch.setattr("knowarm.own_robot.command.check_robot", lambda *a, **o: [])
    new = tmp_path / "map.toml"
    Doctor(robot=joints, calibration=calibration, unit=unit, write=new).run()
    runner = deployment(trained, new).runner()
    home = runner.contract["joints"]["home"]
    rows = runner.contract["knowledge"]["rows"]
    knowledge = rows[0] if rows else None
    runner.reset(Start(dict(zip(runner.joint_names, home, strict=True)), knowledge))
    size = runner.contract["camera"]["size"]
    for _ in range(3):
        runner.act({"image": np.zeros((1, size, size, 3), np.uint8)})
    targets = runner.targets[0]
    assert np.abs(targets - home).max() > 0
    lower = np.array(runner.contract["joints"]["lower"])
    upper = np.array(runner.contract["joints"]["upper"])
    for j, value in enumerate(runner.joint_map.to_real(runner.targets)[0]):
        low, high = ticks[names[j]]
        kind = "deg" if unit == "deg" else "range_m100_100"
        raw = ticks_of(kind, value, low, high)
        turned = (raw - (low + high) / 2) * 2 * math.pi / 4096
        angle = turned + (lower[j] + upper[j]) / 2
        assert math.degrees(abs(angle - targets[j])) < 0.05
