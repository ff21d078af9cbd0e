from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.world.config import EnvConfig
from knowarm.world.objects import TARGETS, find_targets
from knowarm.world.robots import ROBOTS, find_robot
from knowarm.world.scene.appearance import resting_colours
from knowarm.world.scene.compose import attach_robot
from knowarm.world.scene.scene import build_scene, load_scene, project

IRB120, MUG = ROBOTS["irb120"], TARGETS["mug"]
ALL = EnvConfig().targets


@pytest.mark.parametrize(
    ("robot", "start_tcp"),
    [
        ("irb120", (0.500, 0.021, 0.580)),
        ("tiago", (0.730, -0.176, 0.923)),
    ],
)
def test_gripper_starts_where_the_data_sheets_say(robot: str, start_tcp: tuple) -> None:
    scene = load_scene(robot, ALL)
    data = mujoco.MjData(scene.model)
    data.qpos[scene.qpos_index] = scene.home
    mujoco.mj_forward(scene.model, data)
    assert data.site_xpos[scene.tcp_site] == pytest.approx(start_tcp, abs=2e-3)


@pytest.mark.parametrize(
    ("robot", "target", "point", "quaternion"),
    [
        ("irb120", "mug", (-0.0802, 0.0215, 0.066), (0.3794, 0.1206, 0.9160, -0.0500)),
        ("irb120", "bottle", (0, 0, 0.222), (0, 0.7934, 0.6088, 0)),
        (
            "irb120",
            "cereal_box",
            (-0.0566, -0.0566, 0.19),
            (0.6533, -0.2706, 0.6533, 0.2706),
        ),
        ("tiago", "mug", (-0.0802, -0.0215, 0.066), (-0.0500, 0.9160, 0.1206, 0.3794)),
        ("tiago", "bottle", (0, 0, 0.222), (0, -0.1305, 0.9914, 0)),
        (
            "tiago",
            "cereal_box",
            (-0.0566, -0.0566, 0.19),
            (0.6533, -0.2706, 0.6533, 0.2706),
        ),
    ],
)
def test_grasp_frames_stand_as_designed(
    robot: str, target: str, point: tuple, quaternion: tuple
) -> None:
    scene = load_scene(robot, (target,))
    assert scene.grasp_position[0] == pytest.approx(point, abs=1e-4)
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.array(quaternion))
    assert scene.grasp_matrix[0].ravel() == pytest.approx(matrix, abs=5e-4)


@pytest.mark.parametrize("robot", ROBOTS)
def test_only_the_robot_meets_the_support(robot: str) -> None:
    model = load_scene(robot, ALL).model
    for a in range(model.ngeom):
        for b in range(a):
            meets = (model.geom_contype[a] & model.geom_conaffinity[b]) or (
                model.geom_contype[b] & model.geom_conaffinity[a]
            )
            names = {model.geom(g).name.split("/")[0] for g in (a, b)}
            assert bool(meets) == (names in ({"robot", "floor"}, {"robot", "table"}))


def test_irb120_reaches_580_mm_to_the_wrist_and_weighs_what_it_should() -> None:
    model = load_scene("irb120", ("mug",)).model
    data = mujoco.MjData(model)
    data.qpos[:] = [0, np.pi / 2, -np.arctan(302 / 70), 0, 0, 0]
    mujoco.mj_forward(model, data)
    wrist, shoulder = data.body("robot/link_5").xpos, data.body("robot/link_2").xpos
    assert np.linalg.norm(wrist - shoulder) == pytest.approx(0.580, abs=5e-4)
    masses = [6.215, 3.067, 3.909, 2.944, 1.328, 0.546, 0.137]
    names = ["base_link", *(f"link_{i}" for i in range(1, 7))]
    for name, mass in zip(names, masses, strict=True):
        assert model.body(f"robot/{name}").mass[0] == pytest.approx(mass)


def test_colours_are_the_paper_s() -> None:
    scene = load_scene("irb120", ALL)
    assert scene.colour_names == (
        ("red", "blue"),
        ("yellow", "purple"),
        ("brown", "light_blue"),
    )
    assert scene.target_colours[2, 1] == pytest.approx([0.5, 0.7, 0.9])


def test_the_middle_of_the_image_is_where_the_camera_looks() -> None:
    scene = load_scene("irb120", ("mug",))
    assert project(scene, np.array([IRB120.camera_look_at_m]))[0] == pytest.approx(
        [0, 0], abs=1e-9
    )
    behind = 2 * np.array(IRB120.camera_position_m) - IRB120.camera_look_at_m
    assert np.isnan(project(scene, behind[None])).all()


def test_unknown_names_get_the_nearest() -> None:
    with pytest.raises(UserError, match="Did you mean 'irb120'"):
        find_robot("irb12")
    with pytest.raises(UserError, match="Did you mean 'mug'"):
        find_targets(("mugg",))
    with pytest.raises(UserError, match="Did you mean 'cereal_box'"):
        find_targets(("cereal-box",))
    with pytest.raises(
        UserError, match=r"Unknown target 'bottle-x'\. Did you mean 'bottle'"
    ):
        find_targets(("bottle-x",))


def test_a_missing_file_and_broken_mjcf_are_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"no such file\. Correct"):
        build_scene(replace(IRB120, mjcf=tmp_path / "none.xml"), [MUG])
    broken = tmp_path / "broken.xml"
    broken.write_text(
        '<mujoco><worldbody><body><geom size="-1"/></body></worldbody></mujoco>'
    )
    with pytest.raises(UserError, match=r"mjcf .*broken.xml' does not compile"):
        build_scene(replace(IRB120, mjcf=broken), [MUG])
    broken.write_text("<mujoco><worldbody>")
    with pytest.raises(UserError, match=r"mjcf .*broken.xml' does not compile"):
        build_scene(IRB120, [replace(MUG, mjcf=broken)])


def test_what_only_compiling_the_whole_scene_reveals_is_no_traceback() -> None:
    # Which the file has already
    added = replace(IRB120, tcp_body="link_6", tcp_site="tcp")
    with pytest.raises(
        UserError, match=r"robot 'irb120' with mug does not compile: .*repeated"
    ):
        build_scene(added, [MUG])


def test_missing_joints_and_sites_are_named_with_those_there_are() -> None:
    joints = ("joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "wrist")
    with pytest.raises(UserError, match=r"joints names 'wrist'.*joint_6"):
        build_scene(replace(IRB120, joints=joints), [MUG])
    with pytest.raises(UserError, match=r"tcp_site names 'tool'.*Its sites: tcp"):
        build_scene(replace(IRB120, tcp_site="tool"), [MUG])
    with pytest.raises(UserError, match=r"tcp_body names 'hand'.*gripper"):
        build_scene(replace(IRB120, tcp_site="tool", tcp_body="hand"), [MUG])
    with pytest.raises(UserError, match=r"grasp_site names 'handle'.*Its sites: grasp"):
        build_scene(IRB120, [replace(MUG, grasp_site="handle")])
    with pytest.raises(UserError, match=r"coloured_geoms names 'lid'.*cup"):
        build_scene(IRB120, [replace(MUG, coloured_geoms=("lid",))])


def test_a_target_outside_the_image_is_refused() -> None:
    with pytest.raises(UserError, match=r"'mug' standing at .* outside the image"):
        build_scene(replace(IRB120, rectangle_centre_m=(0.47, 0.9)), [MUG])
    with pytest.raises(
        UserError, match=r"camera_position_m .* must not lie straight above"
    ):
        build_scene(replace(IRB120, camera_position_m=(0.42, -0.03, 1.0)), [MUG])


def test_home_outside_the_range_is_refused() -> None:
    with pytest.raises(UserError, match="home of joint 'joint_3' is 2"):
        build_scene(replace(IRB120, home=(0, 0, 2.0, 0, 0, 0)), [MUG])


def test_a_held_joint_stands_where_the_joint_would_carry_it() -> None:
    held = replace(
        IRB120,
        joints=IRB120.joints[:1] + IRB120.joints[2:],
        home=(0.0, 0.4, 0.0, 0.2, 0.0),
        held_joints={"joint_2": 0.3},
        areas={},
    )
    whole, part = load_scene("irb120", ("mug",)), build_scene(held, [MUG])
    tips = []
    for scene, home in ((whole, [0, 0.3, 0.4, 0, 0.2, 0]), (part, held.home)):
        data = mujoco.MjData(scene.model)
        data.qpos[scene.qpos_index] = home
        mujoco.mj_forward(scene.model, data)
        tips.append(data.site_xpos[scene.tcp_site].copy())
    assert tips[0] == pytest.approx(tips[1], abs=1e-9)


@pytest.mark.parametrize(
    "orientation",
    ["quat='.8 .6 0 0'", "euler='40 0 70'", "axisangle='0 1 1 50'", "zaxis='1 1 1'"],
)
def test_a_held_joint_keeps_how_its_body_is_turned(tmp_path, orientation: str) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(
        f"""<mujoco><worldbody><body name="base"><geom size=".05"/>
        <body name="held" pos="0 0 .3" {orientation}>
        <joint name="held" axis="1 2 0" pos=".1 0 0" ref="20"/><geom size=".05"/>
        <body name="tip" pos=".2 0 .1"><joint name="tip" axis="0 1 0"/><geom size=".05"/>
        </body></body></body></worldbody></mujoco>"""
    )
    own = replace(
        IRB120,
        mjcf=path,
        joints=("tip",),
        home=(0.0,),
        start_joints=(),
        held_joints={"held": 0.7},
        areas={},
    )
    spec = mujoco.MjSpec()
    attach_robot(spec, replace(own, tcp_body="tip", base_position_m=(0, 0, 0)))
    poses = []
    for model, name in (
        (mujoco.MjModel.from_xml_path(str(path)), "tip"),
        (spec.compile(), ""),
    ):
        data = mujoco.MjData(model)
        if name:
            data.joint("held").qpos = 0.7
        mujoco.mj_forward(model, data)
        poses.append(data.body(name or "robot/tip").xpos.copy())
    assert poses[0] == pytest.approx(poses[1], abs=1e-9)


def test_two_objects_of_one_name_and_a_robot_among_them_are_refused() -> None:
    with pytest.raises(
        UserError, match="Target 'mug': of the objects mug, mug each needs a name"
    ):
        build_scene(IRB120, [MUG, MUG])
    with pytest.raises(UserError, match="other than 'robot'"):
        build_scene(IRB120, [replace(MUG, name="robot")])


def test_a_geom_s_own_colour_goes_before_its_material_s(tmp_path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(
        """<mujoco><asset><material name="m" rgba="0 0 1 1"/></asset><worldbody>
        <body name="base"><geom name="own" size=".05" material="m" rgba="1 0 0 1"/>
        <body name="tip" pos=".2 0 .1"><joint name="tip"/><geom size=".05" material="m"/>
        </body></body></worldbody></mujoco>"""
    )
    arm = replace(
        IRB120,
        mjcf=path,
        joints=("tip",),
        home=(0.0,),
        start_joints=(),
        areas={},
        tcp_body="tip",
    )
    scene = build_scene(arm, [MUG])
    colours = resting_colours(scene, 1)[0]
    own = scene.model.geom("robot/own").id
    assert colours[own].tolist() == [1, 0, 0, 1]
    assert colours[own + 1].tolist() == [0, 0, 1, 1]
