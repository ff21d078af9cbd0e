"""From the files of SO-101, xArm 6 and Franka to what a served policy sends, in their own units."""

import json
import math
import threading
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from knowarm.cli.main import main
from knowarm.deploy.contract import deployment
from knowarm.deploy.runner import Start
from knowarm.experiment.load import load_agent
from knowarm.own_robot.command import Doctor
from knowarm.own_robot.urdf import as_mjcf
from tests.tiny import TINY, flags

pytest.importorskip("websockets")
pytest.importorskip("msgpack")

from websockets.sync.client import connect

from knowarm.deploy.messages import pack, unpack
from knowarm.deploy.serve import PolicyServer

HALF_A_DEGREE = math.radians(0.5)
TICKS = {
    "shoulder_pan": (748, 3410),
    "shoulder_lift": (837, 3341),
    "elbow_flex": (793, 2995),
    "wrist_flex": (910, 3277),
    "wrist_roll": (150, 3900),
}
"""Ends of the motors of an SO-101, as LeRobot recorded them."""


class Maker(NamedTuple):
    """An arm: limits by the names of its maker's file, with soft ones, and how it counts."""

    limits: dict[str, tuple[float, float]]
    soft: tuple[tuple[float, float], ...]
    unit: str


TURN = 2 * math.pi
ARMS = {
    "so101": Maker(
        {
            "shoulder_pan": (-1.91986, 1.91986),
            "shoulder_lift": (-1.74533, 1.74533),
            "elbow_flex": (-1.69, 1.69),
            "wrist_flex": (-1.65806, 1.65806),
            "wrist_roll": (-2.74385, 2.84121),
        },
        (),
        "range",
    ),
    "xarm6": Maker(
        {
            "joint1": (-TURN, TURN),
            "joint2": (-2.059, 2.0944),
            "joint3": (-3.927, 0.19198),
            "joint4": (-TURN, TURN),
            "joint5": (-1.69297, math.pi),
            "joint6": (-TURN, TURN),
        },
        (),
        "deg",
    ),
    "panda": Maker(
        {
            "panda_joint1": (-2.9671, 2.9671),
            "panda_joint2": (-1.8326, 1.8326),
            "panda_joint3": (-2.9671, 2.9671),
            "panda_joint4": (-3.1416, 0.0873),
            "panda_joint5": (-2.9671, 2.9671),
            "panda_joint6": (-0.0873, 3.8223),
            "panda_joint7": (-2.9671, 2.9671),
        },
        (
            (-2.8973, 2.8973),
            (-1.7628, 1.7628),
            (-2.8973, 2.8973),
            (-3.0718, -0.0698),
            (-2.8973, 2.8973),
            (-0.0175, 3.7525),
            (-2.8973, 2.8973),
        ),
        "rad",
    ),
}


def write_urdf(path: Path, maker: Maker) -> None:
    """Write an arm with the joints of a maker, one above the other."""
    link = """<link name="l{0}"><visual><origin xyz="0 0 .05"/><geometry><box size=".04 .04 .1"/>
      </geometry></visual><collision><origin xyz="0 0 .05"/><geometry><box size=".04 .04 .1"/>
      </geometry></collision></link>"""
    text = link.format(0)
    for number, (name, (low, high)) in enumerate(maker.limits.items()):
        soft = ""
        if maker.soft:
            below, above = maker.soft[number]
            soft = (
                f'<safety_controller soft_lower_limit="{below}" k_velocity="40" '
                f'soft_upper_limit="{above}" k_position="100"/>'
            )
        axis = ("0 0 1", "0 1 0", "0 1 0")[number % 3]
        text += f"""{link.format(number + 1)}<joint name="{name}" type="revolute">
          <parent link="l{number}"/><child link="l{number + 1}"/><origin xyz="0 0 .1"/>
          <axis xyz="{axis}"/><limit lower="{low}" upper="{high}" effort="80" velocity="2"/>
          {soft}</joint>"""
    path.write_text(f'<robot name="arm">{text}</robot>')


def describe(folder: Path, name: str, maker: Maker) -> Path:
    """Convert the maker's file, and write a description with a start in the middle."""
    write_urdf(folder / f"{name}.urdf", maker)
    model, _ = as_mjcf(folder / f"{name}.urdf", folder / name)
    ends = maker.soft or tuple(maker.limits.values())
    home = np.mean(ends, axis=1).round(4).tolist()
    file = folder / f"{name}.toml"
    file.write_text(f"""mjcf = "{model.relative_to(folder)}"
joints = {json.dumps(list(maker.limits))}
tcp_site = "tcp"
tcp_body = "l{len(home)}"
tcp_position_m = [0.0, 0.0, 0.1]
home = {home}
rectangle_centre_m = [0.3, 0.0]
rectangle_half_size_m = [0.05, 0.1]
target_yaw_deg = 180.0
camera_position_m = [1.2, -0.9, 0.9]
camera_look_at_m = [0.3, 0.0, 0.2]
camera_fovy_deg = 40.0
""")
    return file


def angles_of(name: str, values: np.ndarray) -> np.ndarray:
    """Return the model's angles [rad] of what the arm itself counts, by its maker's formulas."""
    if name == "panda":  # libfranka counts in radians
        return values
    if name == "xarm6":  # the SDK's is_radian=False
        return values * math.pi / 180
    angles = []
    for value, motor in zip(values, TICKS, strict=True):
        low, high = TICKS[motor]
        # LeRobot's inverse of its normalization, and a turn of 4096 ticks
        tick = (value + 100) / 200 * (high - low) + low
        turned = (tick - (low + high) / 2) / 4096 * TURN
        angles.append(turned + sum(ARMS["so101"].limits[motor]) / 2)
    return np.array(angles)


@pytest.mark.parametrize("name", ARMS)
def test_what_is_served_is_within_half_a_degree_of_the_makers_units(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    maker = ARMS[name]
    robot = describe(tmp_path, name, maker)
    monkeypatch.setattr("knowarm.own_robot.command.check_robot", lambda *a, **o: [])
    options = {"unit": maker.unit, "write": tmp_path / "map.toml"}
    if name == "so101":
        motors = {}
        for number, (motor, (low, high)) in enumerate(TICKS.items(), start=1):
            motors[motor] = {
                "id": number,
                "drive_mode": 0,
                "homing_offset": -321,
                "range_min": low,
                "range_max": high,
            }
        (tmp_path / "arm.json").write_text(json.dumps(motors))
        options["calibration"] = tmp_path / "arm.json"
    Doctor(robot=str(robot), **options).run()
    runs = tmp_path / "runs"
    arguments = ["train", "full-ppo", "--env.robot", str(robot), "--runs", str(runs)]
    assert main([*arguments, *flags(TINY)]) == 0
    (folder,) = runs.glob("*/0")
    parts = deployment(load_agent(folder), tmp_path / "map.toml")
    server = PolicyServer(parts.runner, port=0)
    threading.Thread(target=server.run, daemon=True).start()
    generator = np.random.default_rng(0)
    inside = parts.runner()
    ends = np.array(maker.soft or [*maker.limits.values()])
    try:
        with connect(f"ws://127.0.0.1:{server.port}", compression=None) as link:
            about = unpack(link.recv())
            np.testing.assert_allclose(
                np.transpose([about["joints"]["lower"], about["joints"]["upper"]]),
                ends,
                atol=1e-4,
            )
            size = about["camera"]["size"]
            state = inside.joint_map.to_real(np.array(about["joints"]["home"]))
            farthest = 0.0
            for step in range(30):
                image = generator.integers(0, 255, (size, size, 3), np.uint8)
                observation = {"observation/image": image, "observation/state": state}
                link.send(pack(observation | {"prompt": None, "reset": step == 0}))
                (sent,) = unpack(link.recv())["actions"]
                if step == 0:
                    start = dict(
                        zip(inside.joint_names, about["joints"]["home"], strict=True)
                    )
                    inside.reset(Start(start, None))
                inside.act({"image": image[None]})
                wanted = inside.targets[0]
                angles = angles_of(name, np.asarray(sent))
                assert np.abs(angles - wanted).max() < HALF_A_DEGREE
                assert (angles > ends[:, 0] - HALF_A_DEGREE).all()
                assert (angles < ends[:, 1] + HALF_A_DEGREE).all()
                farthest = max(farthest, np.abs(wanted - about["joints"]["home"]).max())
            assert farthest > 0.2, "the targets have left the start"
    finally:
        server.close()
