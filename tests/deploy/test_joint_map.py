"""The joint map: to the real arm and back is the identity; rules hold in the robot's radians."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from knowarm.deploy.contract import deployment
from knowarm.deploy.driver import Driver, Safety
from knowarm.deploy.joint_map import real_joints
from knowarm.deploy.runner import JointMap, Runner, fingerprint
from knowarm.errors import UserError
from knowarm.world.robots import ROBOTS
from knowarm.world.robots.robot import RealJoint
from tests.deploy.test_driver import CONTRACT, IMAGE

MODEL = mujoco.MjModel.from_xml_path(str(ROBOTS["irb120"].mjcf))
UNITS = ("rad", "deg", "range_0_100", "range_m100_100")
JOINTS = CONTRACT["joints"]
REAL = [
    {
        "joint": "elbow",
        "name": "E.pos",
        "unit": "deg",
        "scale": -180 / math.pi,
        "offset": 90.0,
    },
    {
        "joint": "jaw",
        "name": "jaw.pos",
        "unit": "range_0_100",
        "scale": 0.0,
        "offset": 60.0,
    },
    {
        "joint": "shoulder",
        "name": "S.pos",
        "unit": "deg",
        "scale": 180 / math.pi,
        "offset": 0.0,
    },
]
MAPPED = CONTRACT | {"joints": JOINTS | {"real": REAL}}


def scene_with(joint_map, **changes):
    robot = replace(ROBOTS["irb120"], joint_map=joint_map, **changes)
    count = len(robot.joints)
    lower, upper = np.full(count, -1.5), np.linspace(0.5, 3, count)
    limits = {
        "joint_lower": lower,
        "joint_upper": upper,
        "qpos_index": range(count),
        "fingers": None,
    }
    return SimpleNamespace(robot=robot, joint_names=robot.joints, model=MODEL, **limits)


real_joint = st.builds(
    RealJoint,
    sign=st.sampled_from([1, -1]),
    offset=st.floats(-400, 400).map(lambda offset: round(offset, 6)),
    unit=st.sampled_from(UNITS),
)


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(real_joint, min_size=6, max_size=6),
    st.permutations(ROBOTS["irb120"].joints),
    st.lists(st.floats(-7, 7), min_size=6, max_size=6),
)
def test_to_the_real_arm_and_back_is_the_identity(reals, order, angles):
    entries = real_joints(scene_with(dict(zip(order, reals, strict=True))))
    joint_map = JointMap({"names": ROBOTS["irb120"].joints, "real": entries})
    assert joint_map.names == tuple(order)
    values = joint_map.to_real([angles])
    np.testing.assert_allclose(joint_map.from_real(values), [angles], atol=1e-9)
    np.testing.assert_allclose(
        joint_map.to_real(joint_map.from_real(values)), values, atol=1e-9
    )


@pytest.mark.parametrize(
    ("joint", "real"),
    [
        (RealJoint(unit="deg"), (-85.944, 0.0)),
        (RealJoint(unit="deg", sign=-1, offset=10.0), (95.944, 10.0)),
        (RealJoint(unit="range_0_100"), (0.0, 75.0)),
        (RealJoint(unit="range_m100_100", sign=-1), (100.0, -50.0)),
        (RealJoint(unit="range_0_100", sign=-1, offset=100.0), (100.0, 25.0)),
        (RealJoint(), (-1.5, 0.0)),
    ],
)
def test_values_of_the_units_at_the_lower_limit_and_at_zero(joint, real):
    entry = real_joints(scene_with(dict.fromkeys(ROBOTS["irb120"].joints, joint)))[0]
    found = [entry["scale"] * angle + entry["offset"] for angle in (-1.5, 0.0)]
    np.testing.assert_allclose(found, real, atol=1e-3)


def test_a_held_joint_is_sent_at_its_value():
    robot = ROBOTS["irb120"]
    joint_map = dict.fromkeys(robot.joints, RealJoint(unit="deg", offset=1.0))
    fewer = {"joints": robot.joints[:5], "home": robot.home[:5], "areas": {}}
    entry = real_joints(scene_with(joint_map, **fewer, held_joints={"joint_6": 0.5}))[
        -1
    ]
    assert (entry["scale"], entry["offset"]) == (
        0.0,
        pytest.approx(math.degrees(0.5) + 1),
    )
    assert real_joints(scene_with(joint_map, **fewer))[-1]["offset"] == 1.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"joint_6": None}, "must name every joint"),
        ({"joint_9": RealJoint()}, "joint_map names 'joint_9'"),
        ({"joint_1": RealJoint(name="joint_2")}, "a name twice"),
    ],
)
def test_a_map_that_does_not_fit_is_refused(change, words):
    joint_map = dict.fromkeys(ROBOTS["irb120"].joints, RealJoint()) | change
    with pytest.raises(UserError, match=words):
        real_joints(
            scene_with({name: real for name, real in joint_map.items() if real})
        )


def mapped_runner(step):
    """A runner whose policy raises the shoulder by ``step`` and lowers the elbow."""

    def policy(inputs):
        return np.array([[1, 2]]) * step, None, None, inputs["h"], inputs["c"]

    return Runner(MAPPED, np.zeros((2, 3), np.float32), policy)


def test_the_driver_converts_at_its_doors_and_keeps_its_rules_in_radians():
    driver = Driver(
        mapped_runner(1),
        lambda angles: np.array([*angles, 0.0]),
        Safety(confirm_steps=0),
        "usedFor drinking",
    )
    driver.see(IMAGE, 1.0)
    driver.feel(["jaw.pos"], [60.0], 1.0)
    driver.feel(["S.pos", "E.pos"], [10.0, 90.0 - math.degrees(0.5)], 1.0)
    targets = driver.tick(1.0)
    assert driver.joint_names == ("E.pos", "jaw.pos", "S.pos")
    moved = math.degrees(0.05)
    np.testing.assert_allclose(targets, [90 - math.degrees(0.45), 60.0, 10.0 + moved])
    driver.feel(["S.pos", "E.pos"], [100.0, 90.0], 1.1)
    driver.tick(driver.clock() + 1)
    assert "jump" in str(driver._inputs["joint angles"])


@pytest.mark.parametrize(
    "change", [{"scale": 0.0}, {"offset": math.nan}, {"name": "E.pos"}], ids=str
)
def test_a_damaged_map_moves_nothing(change):
    real = [*REAL[:2], REAL[2] | change]
    contract = CONTRACT | {"joints": JOINTS | {"real": real}}
    with pytest.raises(ValueError, match="twice, or numbers"):
        Runner(contract, np.zeros((2, 3), np.float32), lambda inputs: ())


def test_a_file_gives_a_policy_its_map_which_its_digest_covers(trained, tmp_path):
    names, file = trained.config.env.robot, tmp_path / "map.toml"
    lines = [f'{name} = {{unit = "deg"}}' for name in ROBOTS[names].joints]
    file.write_text("\n".join(["[joint_map]", *lines]))
    plain, mapped = deployment(trained).contract, deployment(trained, file).contract
    assert "real" not in plain["joints"], "nothing is converted"
    assert [each["unit"] for each in mapped["joints"]["real"]] == ["deg"] * 6
    assert fingerprint(plain) != fingerprint(mapped)
    assert json.loads(json.dumps(mapped))["joints"]["real"] == mapped["joints"]["real"]
    file.write_text("")
    with pytest.raises(UserError, match="no table joint_map"):
        deployment(trained, file)
