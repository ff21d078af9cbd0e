"""Lift test: what holds, what does not, and why."""

import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.world.objects import PARTS, TARGETS
from knowarm.world.robots import ROBOTS
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.compose import compose
from knowarm.world.scene.scene import build_scene
from knowarm.world.tasks.skills.lift import model as lift_model_module
from knowarm.world.tasks.skills.lift.model import OBJECT_BIT, build_lift_scene
from knowarm.world.tasks.skills.lift.probe import LIFT_M, WAYPOINTS, lift, plan_lifts

GANTRY = """
<mujoco><worldbody><body name="x"><joint name="x" type="slide" axis="1 0 0" range="-1 1"/>
<geom type="box" size=".02 .02 .02" mass="1" contype="0" conaffinity="0"/>
<body name="y"><joint name="y" type="slide" axis="0 1 0" range="-1 1"/>
<geom type="box" size=".02 .02 .02" mass="1" contype="0" conaffinity="0"/>
<body name="z"><joint name="z" type="slide" axis="0 0 1" range="-1 1"/>
<geom type="box" size=".04 .05 .02" pos="0 0 .08" mass="1"/>
<site name="tcp" quat="0 1 0 0"/>
<body name="left"><joint type="slide" axis="0 1 0"/>
<geom type="box" size=".011 .006 .038" pos="0 .038 .018" mass=".05"/></body>
<body name="right"><joint type="slide" axis="0 1 0"/>
<geom type="box" size=".011 .006 .038" pos="0 -.038 .018" mass=".05"/></body>
</body></body></body></worldbody></mujoco>
"""
"""Three slides that carry a gripper which points down; its fingers are bodies, 64 mm apart."""
AT = np.array([0.1, 0.2])  # x and y of the object [m]


@pytest.fixture
def gantry(tmp_path) -> Robot:
    """Return the gantry, whose joint values are the position of its gripper."""
    path = tmp_path / "gantry.xml"
    path.write_text(GANTRY)
    return Robot(
        name="gantry",
        mjcf=path,
        joints=("x", "y", "z"),
        tcp_site="tcp",
        fingers=("left", "right"),
        home=(0.0, 0.0, 0.5),
        rectangle_centre_m=(0.1, 0.2),
        rectangle_half_size_m=(0.1, 0.1),
        target_yaw_deg=0.0,
        camera_position_m=(1.5, 0.0, 1.5),
        camera_look_at_m=(0.0, 0.1, 0.0),
        camera_fovy_deg=60.0,
    )


CAPSULE = 'type="capsule" size=".006" fromto=".064 {y} 0 .14 {y} 0"'
MESH = 'type="mesh" mesh="pad" pos=".102 {y} 0"'
PAD = " ".join(
    f"{x} {y} {z}"
    for z in (-0.01, 0.01)
    for y in (-0.006, 0.006)
    for x in (-0.04, 0.03)
)


@pytest.mark.parametrize("shape", [CAPSULE, MESH])
def test_fingers_may_be_geoms_of_any_shape(shape, tmp_path):
    irb120 = ROBOTS["irb120"]
    text = irb120.mjcf.read_text().replace(
        "</asset>", f'<mesh name="pad" vertex="{PAD}"/></asset>'
    )
    for side, y in (("left", 0.038), ("right", -0.038)):
        new = f'<geom name="finger_{side}" {shape.format(y=y)} material="finger" mass=".05"/>'
        text, count = re.subn(rf'<geom name="finger_{side}"[^/]*/>', new, text)
        assert count == 1
    path = tmp_path / "arm.xml"
    path.write_text(text)
    robot = replace(irb120, mjcf=path).for_area("lift")
    poses = []
    for build in (build_scene, build_lift_scene):
        model = build(robot, [TARGETS["mug"]]).model
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        geoms = [data.geom(f"robot/finger_{side}") for side in ("left", "right")]
        poses.append([np.r_[geom.xpos, geom.xmat] for geom in geoms])
    np.testing.assert_allclose(*poses, atol=1e-12)


def down_to(x: float, y: float, z: float) -> np.ndarray:
    """Return a path (12, 3) [m] from 12 cm above a point."""
    return np.array([[x, y, z + height] for height in np.linspace(0.12, 0.0, 12)])


def lifts(robot: Robot, paths: list[np.ndarray], target: str = "bottle"):
    """Lift the object of a name at ``AT`` by each path."""
    scene = build_scene(robot, [TARGETS[target]])
    n = len(paths)
    return lift(scene, paths, np.zeros((n, 1), dtype=np.int64), np.tile(AT, (n, 1, 1)))


def test_the_pose_of_the_fingers_decides(gantry):
    x, y, z = *AT, 0.222
    aside = np.array(
        [[x, y + 0.3, 0.1], *np.linspace([x, y + 0.3, 0.1], [x, y, 0.1], 12)]
    )
    paths = [
        down_to(x, y, z),  # on the stopper
        down_to(x, y, z + 0.05),  # above it
        down_to(x + 0.05, y, z),  # beside it
        aside,  # a finger sweeps the bottle away
    ]
    result = lifts(gantry, paths)
    assert result.outcome.tolist() == ["lifted", "missed", "missed", "pushed"]
    assert result.rise[0] == pytest.approx(LIFT_M, abs=0.01)
    assert (np.abs(result.rise[1:3]) < 0.01).all()
    assert (result.moved[:3] < 0.005).all()
    assert result.moved[3] > 0.02


def test_a_part_is_lifted_with_its_whole_object(gantry):
    """The goal is the second part in the scene; the others are those of a globe beside it."""
    names = ("brush.block", "brush.handle", "globe.pin", "globe.stem")
    scene = build_scene(gantry, [PARTS[name] for name in names])
    places = np.array([AT, AT, AT + 0.2, AT + 0.2])[None]
    result = lift(scene, [down_to(*AT, 0.16)], np.array([[1, 0, 2, 3]]), places)
    assert result.outcome.tolist() == ["lifted"]
    assert result.rise[0] == pytest.approx(LIFT_M, abs=0.01)


def test_a_lift_depends_on_itself_only(gantry):
    paths = [down_to(*AT, 0.222), down_to(AT[0] + 0.01, AT[1] + 0.005, 0.21)]
    together, alone = lifts(gantry, paths), lifts(gantry, paths[1:])
    assert together.rise[1] == alone.rise[0]
    assert together.outcome[1] == alone.outcome[0]


def test_without_friction_the_bottle_stays(gantry, monkeypatch):
    monkeypatch.setattr(lift_model_module, "PAD_FRICTION", (0.01, 0.0001, 0.0001))
    result = lifts(gantry, [down_to(*AT, 0.222)])
    assert result.outcome.tolist() == ["slipped"]
    assert result.rise[0] < 0.02


def test_an_arm_that_cannot_rise_is_named(gantry):
    path = gantry.mjcf
    path.write_text(
        GANTRY.replace('axis="0 0 1" range="-1 1"', 'axis="0 0 1" range="-1 .24"')
    )
    low = replace(gantry, home=(0.0, 0.0, 0.2))
    assert lifts(low, [down_to(*AT, 0.222)[8:]]).outcome.tolist() == ["arm"]


def test_the_way_upwards_is_straight(gantry):
    way = plan_lifts(build_scene(gantry, [TARGETS["mug"]]), np.array([[0.1, 0.2, 0.3]]))
    heights = 0.3 + LIFT_M * np.arange(1, WAYPOINTS + 1) / WAYPOINTS
    assert np.allclose(
        way[0],
        np.stack([np.full(WAYPOINTS, 0.1), np.full(WAYPOINTS, 0.2), heights], axis=1),
    )


@pytest.mark.parametrize(("name", "opening_m"), [("irb120", 0.064), ("tiago", 0.078)])
def test_all_objects_stand_still_with_their_masses(name, opening_m):
    robot = replace(ROBOTS[name], table=None, camera_fovy_deg=120.0)
    scene = build_lift_scene(robot, tuple(TARGETS.values()))
    model = scene.model
    assert scene.joint_upper[-1] > opening_m / 2
    assert model.jnt_range[model.joint("left").id] == pytest.approx([0, opening_m / 2])
    data = mujoco.MjData(model)
    for i, start in enumerate(scene.object_qpos):
        data.qpos[start : start + 7] = scene.rest[i]
        data.qpos[start : start + 2] = 2 + 0.5 * (i % 6), 0.5 * (i // 6)
    bodies = [model.body(f"{name}/{name}").id for name in TARGETS]
    assert model.body_mass[bodies] == pytest.approx(
        [t.mass_kg for t in TARGETS.values()]
    )
    mujoco.mj_forward(model, data)
    before = data.xipos[bodies].copy()
    mujoco.mj_step(model, data, nstep=500)
    moved = np.linalg.norm(data.xipos[bodies] - before, axis=1)
    assert dict(zip(TARGETS, moved, strict=True)) == {
        n: pytest.approx(0, abs=2e-3) for n in TARGETS
    }


def test_the_reaching_scene_knows_no_fingers():
    robot, targets = ROBOTS["irb120"], [TARGETS["mug"]]
    drawn = compose(robot, targets).to_xml()
    assert drawn == compose(replace(robot, fingers=()), targets).to_xml()
    build_lift_scene(robot, targets)
    model = compose(robot, targets).compile()
    assert model.nq == len(robot.joints)
    assert not (model.geom_contype & OBJECT_BIT).any()


@pytest.mark.parametrize(
    ("fingers", "message"),
    [
        ((), "names no fingers"),
        (("left", "rihgt"), "fingers names 'rihgt', which gantry.xml"),
    ],
)
def test_a_robot_without_fingers_is_refused(gantry, fingers, message):
    with pytest.raises(UserError, match=message):
        build_lift_scene(replace(gantry, fingers=fingers), [TARGETS["mug"]])


def test_a_finger_without_geoms_is_refused(tmp_path, gantry):
    path = tmp_path / "bare.xml"
    path.write_text(
        GANTRY.replace('<body name="left">', '<body name="bare"/><body name="left">')
    )
    bare = replace(gantry, mjcf=path, fingers=("bare", "right"))
    with pytest.raises(
        UserError, match="fingers names the body 'bare', which has no geoms"
    ):
        build_lift_scene(bare, [TARGETS["mug"]])


@pytest.mark.parametrize("own", ['density="500"', 'mass="0.05"', ""])
def test_an_object_has_its_mass_whatever_its_file_says(tmp_path, gantry, own):
    path = tmp_path / "brick.xml"
    path.write_text(
        f"""<mujoco><worldbody><body><geom type="box" size=".02 .02 .02" pos="0 0 .02" {own}/>
        <geom name="top" type="box" size=".01 .01 .01" pos="0 0 .05"/>
        <site name="grasp" pos="0 0 .04"/><light/></body></worldbody>
        <sensor><clock/></sensor></mujoco>"""
    )
    brick = replace(
        TARGETS["mug"], name="brick", mjcf=path, xml=None, coloured_geoms=("top",)
    )
    scene = build_lift_scene(gantry, [replace(brick, grasp_site="grasp", mass_kg=0.3)])
    assert scene.model.body_mass[scene.bodies] == pytest.approx([0.3])
    assert scene.model.nlight == 1


@pytest.mark.parametrize("name", ROBOTS)
def test_objects_left_out_exist_and_have_a_reason(name):
    left_out = ROBOTS[name].cannot_hold
    assert set(left_out) <= set(TARGETS)
    assert all(left_out.values())
    assert {"mug", "bottle", "cereal_box"}.isdisjoint(left_out)
