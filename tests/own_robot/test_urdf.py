"""URDF and xacro: converted with visuals, frames, mimic joints and colours, or refused by cause."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

from knowarm.errors import UserError
from knowarm.own_robot.draft_gripper import find_gripper
from knowarm.own_robot.urdf import as_mjcf
from knowarm.world.description import description_files
from knowarm.world.robots import find_robot
from knowarm.world.scene.mjcf import read_mjcf

pytestmark = pytest.mark.usefixtures("unfenced")

LINK = """<link name="l{0}"><inertial><mass value="1"/><inertia ixx="{1}" iyy=".01" izz=".01"
  ixy="0" ixz="0" iyz="0"/></inertial>
  <visual name="v"><origin xyz="0 0 .1"/><geometry>{2}</geometry></visual></link>
  <joint name="j{0}" type="revolute"><parent link="{3}"/><child link="l{0}"/><axis xyz="0 {4} 1"/>
  <origin xyz="0 0 .2"/><limit lower="-2" upper="2" effort="5" velocity="1"/>{5}</joint>"""
TOOL = """<link name="tool0"/><joint name="fixed" type="fixed"><parent link="l4"/>
  <child link="tool0"/><origin xyz="0 0 .15"/></joint></robot>"""


def urdf(
    shape: str = '<sphere radius=".05"/>', ixx: float = 0.01, mimic: str = ""
) -> str:
    links = "".join(
        LINK.format(
            i, ixx, shape, f"l{i - 1}" if i else "base", i % 2, mimic if i == 4 else ""
        )
        for i in range(5)
    )
    return f'<robot name="r"><link name="base"/>{links}{TOOL}'


def convert(
    folder: Path, text: str, name: str = "arm.urdf", **options
) -> mujoco.MjModel:
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(text)
    file, note = as_mjcf(folder / name, folder / "out", **options)
    assert f"converted from {Path(name).name}" in note
    model = mujoco.MjModel.from_xml_path(str(file))
    (folder / "out.toml").write_text(f"mjcf = '{file}'")
    assert {"out.toml", f"model/{file.name}"} <= set(
        description_files(folder / "out.toml")
    )
    return model


def test_collision_shapes_are_drawn_only_where_a_file_has_no_visuals(
    tmp_path: Path,
) -> None:
    """A link of collisions alone may be a safety box, which no viewer of URDF draws."""
    both = '</visual><collision><geometry><sphere radius=".1"/></geometry></collision>'
    text = urdf().replace("</visual>", both, 2)
    model = convert(tmp_path / "some", text.replace("visual", "collision", 2))
    assert model.geom_group[model.geom_size[:, 0] == 0.1].tolist() == [3, 3]
    assert (model.geom_contype[model.geom_size[:, 0] == 0.1] == 1).all()
    assert (model.geom_group == 1).sum() == 4
    none = convert(tmp_path / "none", text.replace("visual", "collision"))
    assert (none.geom_group == 0).all()


@pytest.mark.parametrize("name", ["arm.urdf", "arm.xml"])
def test_visuals_and_fixed_frames_are_kept(name: str, tmp_path: Path) -> None:
    model = convert(tmp_path, urdf(), name)
    assert (model.ngeom, model.njnt) == (5, 5)
    assert find_gripper(model).how.endswith("TCP: site 'tool0'")


def test_continuous_joints_have_no_range(tmp_path: Path) -> None:
    text = urdf().replace("revolute", "continuous").replace('lower="-2" upper="2"', "")
    assert not convert(tmp_path, text).jnt_limited.any()


def test_a_follower_is_no_joint_of_the_arm(tmp_path: Path) -> None:
    model = convert(tmp_path, urdf(mimic='<mimic joint="j3" multiplier="-1"/>'))
    assert model.neq == 1
    np.testing.assert_allclose(model.eq_data[0, :2], [0, -1])


def test_inertias_are_repaired_and_named(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(
        re.sub("<inertial>.*?</inertial>", "", urdf(ixx=0.05), count=1, flags=re.DOTALL)
    )
    file, note = as_mjcf(tmp_path / "arm.urdf", tmp_path / "out")
    assert (
        "as the file has none: l0; impossible inertia repaired: l1, l2, l3, l4" in note
    )
    model = mujoco.MjModel.from_xml_path(str(file))
    assert model.njnt == 5
    np.testing.assert_allclose(model.body("l1").inertia, 0.07 / 3, rtol=1e-4)
    negative = (
        urdf()
        .replace('ixx="0.01"', 'ixx="-1"')
        .replace('<mass value="1"/>', '<mass value="0"/>')
    )
    (tmp_path / "arm.urdf").write_text(negative)
    file, note = as_mjcf(tmp_path / "arm.urdf", tmp_path / "negative")
    assert "impossible inertia repaired: l0, l1, l2, l3, l4" in note
    assert mujoco.MjModel.from_xml_path(str(file)).body("l0").inertia.min() > 0


def test_collada_keeps_its_colours_and_packages_are_found(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("collada")
    boxes = []
    for i in range(2):
        box = trimesh.creation.box([10, 10, 10])
        box.apply_translation([0, 0, 20 * i])
        box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)))
        boxes.append(box)
    text = trimesh.exchange.dae.export_collada(boxes).decode()
    text = text.replace("<up_axis>", '<unit name="centimetre" meter="0.01"/><up_axis>')
    for colour in ("1 0 0 1", "0 0 1 1"):
        text = re.sub(
            r"<diffuse>\s*<color>.*</color>",
            f"<diffuse ><color>{colour}</color>",
            text,
            count=1,
        )
    mesh = tmp_path / "arm_description" / "meshes" / "link 1.dae"
    mesh.parent.mkdir(parents=True)
    mesh.write_text(text)
    shape = '<mesh filename="package://arm_description/meshes\\link%201.dae" scale="2 2 2"/>'
    model = convert(tmp_path, urdf(shape), "arm_bringup/urdf/arm.urdf")
    assert model.ngeom == 2 * 5
    assert {tuple(rgba) for rgba in model.geom_rgba.round().tolist()} == {
        (1, 0, 0, 1),
        (0, 0, 1, 1),
    }
    assert model.geom_aabb[:, 3:].max() == pytest.approx(0.1)
    mesh.write_text("broken")
    with pytest.raises(UserError, match=r"link 1\.dae.* damaged or of another format"):
        as_mjcf(tmp_path / "arm_bringup/urdf/arm.urdf", tmp_path / "again")


PACKAGE = "<package><name>{}</name></package>"


@pytest.mark.parametrize("name", ["by package.xml", "by its folder", "given", "copied"])
def test_a_mesh_is_that_of_its_own_package(name: str, tmp_path: Path) -> None:
    """Arms and grippers often have meshes of the same path."""
    trimesh = pytest.importorskip("trimesh")
    hand = {"by package.xml": "other", "given": "far/away/other"}.get(name, "hand")
    for folder, size in (("arm", 0.1), (hand, 0.02)):
        mesh = tmp_path / folder / "meshes" / "base.stl"
        if name == "copied" and folder == hand:
            continue
        mesh.parent.mkdir(parents=True)
        trimesh.creation.box([size] * 3).export(mesh)
    if name == "by package.xml":
        (tmp_path / hand / "package.xml").write_text(PACKAGE.format("hand"))
    options = {"packages": [f"hand={tmp_path / hand}"]} if name == "given" else {}
    (tmp_path / "arm" / "urdf").mkdir()
    file = tmp_path / "arm" / "urdf" / "arm.urdf"
    file.write_text(urdf('<mesh filename="package://hand/meshes/base.stl"/>'))
    model, note = as_mjcf(file, tmp_path / "out", **options)
    is_guessed = name == "copied"
    size = mujoco.MjModel.from_xml_path(str(model)).geom_aabb[:, 3:].max()
    assert size == pytest.approx(0.05 if is_guessed else 0.01)
    assert note.endswith(f"paths only: hand is {tmp_path / 'arm'}") is is_guessed


XACRO = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:include filename="$(find parts)/macro.xacro"/><xacro:arm radius="$(arg radius)"/>
  </robot>"""


def test_xacro_is_expanded_with_its_arguments_and_packages(tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    (tmp_path / "arm.urdf.xacro").write_text(XACRO)
    body = (
        urdf('<sphere radius="${radius}"/>').partition(">")[2].removesuffix("</robot>")
    )
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "macro.xacro").write_text(
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro">'
        f'<xacro:macro name="arm" params="radius">{body}</xacro:macro></robot>'
    )
    file, given = tmp_path / "arm.urdf.xacro", {"arguments": ["radius:=.03"]}
    with pytest.raises(UserError, match=r"Package 'parts' .* --package parts=FOLDER"):
        as_mjcf(file, tmp_path / "out", **given)
    packages = {"packages": [f"parts={tmp_path / 'elsewhere'}"]}
    with pytest.raises(UserError, match=r"radius.* --xacro name:=value"):
        as_mjcf(file, tmp_path / "out", **packages)
    model, _ = as_mjcf(file, tmp_path / "out", **given, **packages)
    assert model == tmp_path / "out" / "arm.xml"
    np.testing.assert_allclose(
        mujoco.MjModel.from_xml_path(str(model)).geom_size[:, 0], 0.03
    )


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        ("<robot", {}, "not valid XML"),
        (
            "<robot>" + "<a>" * 3000 + "</a>" * 3000 + "</robot>",
            {},
            "maximum recursion depth",
        ),
        (urdf('<mesh filename="none.stl"/>'), {}, "Mesh 'none.stl' .* is not found"),
        (
            urdf('<mesh filename="package://no/b/a.stl"/>'),
            {},
            "Give its folder, which holds b/a.stl: --package no=FOLDER",
        ),
        (urdf('<mesh filename="file:///C:/a.stl"/>'), {}, "Mesh 'file:///C:/a.stl'"),
        (urdf().replace('link="l3"', 'link="l9"'), {}, "cannot be converted"),
        (urdf(), {"arguments": ["a:=1"]}, "--xacro needs a .xacro file"),
        (urdf(), {"packages": ["a"]}, "--package must have the form name=value"),
        (f"<<<<<<< HEAD\n{urdf()}", {}, "it holds the markers of an unfinished merge"),
        (
            '<sdf version="1.6"><model name="m"/></sdf>',
            {},
            "holds <sdf>, and neither a",
        ),
        ("<mujocoinclude/>", {}, "holds <mujocoinclude>, and neither a URDF"),
        ('<robot name="r"><group name="arm"/></robot>', {}, "describes no links"),
        ("<!DOCTYPE html><html><body>404</body></html>", {}, "arm.urdf is a web page"),
    ],
)
def test_what_cannot_be_converted_is_refused(
    text: str, options: dict, words: str, tmp_path: Path
) -> None:
    (tmp_path / "arm.urdf").write_text(text)
    with pytest.raises(UserError, match=words):
        as_mjcf(tmp_path / "arm.urdf", tmp_path / "out", **options)


IN_XACRO = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{}</robot>'
POINTER = (
    f"version https://git-lfs.github.com/spec/v1\noid sha256:{'0' * 64}\nsize 104284\n"
)


@pytest.mark.parametrize("suffix", ["stl", "STL", "obj", "dae"])
@pytest.mark.parametrize("kind", ["visual", "collision"])
def test_a_pointer_of_git_lfs_is_named_with_the_command_that_fetches_it(
    suffix: str, kind: str, tmp_path: Path
) -> None:
    mesh = tmp_path / "meshes" / f"link.{suffix}"
    mesh.parent.mkdir()
    mesh.write_text(POINTER)
    text = urdf(f'<mesh filename="meshes/link.{suffix}"/>').replace("visual", kind)
    (tmp_path / "arm.urdf").write_text(text)
    words = f"pointer of Git LFS.* git -C {mesh.parent} lfs pull"
    with pytest.raises(UserError, match=words):
        as_mjcf(tmp_path / "arm.urdf", tmp_path / "out")


@pytest.mark.parametrize("suffix", ["stl", "obj", "dae"])
def test_a_web_page_that_was_saved_as_a_mesh_is_named(
    suffix: str, tmp_path: Path
) -> None:
    (tmp_path / f"link.{suffix}").write_text("\n<!doctype HTML><p>Not found")
    (tmp_path / "arm.urdf").write_text(urdf(f'<mesh filename="link.{suffix}"/>'))
    with pytest.raises(UserError, match=f"link.{suffix} is a web page"):
        as_mjcf(tmp_path / "arm.urdf", tmp_path / "out")


@pytest.mark.parametrize(
    ("part", "words"),
    [
        (POINTER, "part.xacro is a pointer of Git LFS"),
        ("<!DOCTYPE html>", "part.xacro is a web page"),
        ("<robot>", "part.xacro: no element found"),
        ("", "part.xacro: no element found"),
    ],
)
def test_the_included_file_that_is_wrong_is_named(
    part: str, words: str, tmp_path: Path
) -> None:
    text = IN_XACRO.format('<xacro:include filename="part.xacro"/>')
    (tmp_path / "arm.xacro").write_text(text)
    (tmp_path / "part.xacro").write_text(part)
    with pytest.raises(UserError, match=words):
        as_mjcf(tmp_path / "arm.xacro", tmp_path / "out")


@pytest.mark.parametrize("name", ["arm.URDF", "arm.Xml"])
def test_suffixes_may_be_in_capitals(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(urdf())
    file, note = as_mjcf(tmp_path / name, tmp_path / "out")
    assert file.is_file()
    assert note
    with pytest.raises(UserError, match="is a model file"):
        find_robot(str(tmp_path / name))


@pytest.mark.parametrize("name", ["arm.sdf", "arm.usd", "arm.json"])
def test_other_models_are_refused_with_those_that_are_read(
    name: str, tmp_path: Path
) -> None:
    (tmp_path / name).touch()
    with pytest.raises(UserError, match="Other models than URDF, xacro and MJCF"):
        find_robot(str(tmp_path / name))


@pytest.mark.parametrize("name", ["arm.urdf", "arm.xml", "arm.urdf.xacro"])
def test_a_model_that_is_a_pointer_is_named(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(POINTER)
    with pytest.raises(UserError, match=f"{name} is a pointer of Git LFS"):
        as_mjcf(tmp_path / name, tmp_path / "out")


@pytest.mark.parametrize(
    "asset",
    [
        '<mesh name="m" file="part.stl"/>',
        '<mesh name="m" file="part.obj"/>',
        '<texture name="t" type="2d" file="part.png"/>',
    ],
)
def test_an_mjcf_file_with_a_pointer_is_refused_by_it(
    asset: str, tmp_path: Path
) -> None:
    (name,) = re.findall("part[.][a-z]+", asset)
    (tmp_path / name).write_text(POINTER)
    text = f"<mujoco><asset>{asset}</asset><worldbody/></mujoco>"
    (tmp_path / "arm.xml").write_text(text)
    with pytest.raises(UserError, match=f"{name} is a pointer of Git LFS"):
        read_mjcf(tmp_path / "arm.xml", "Robot 'arm'")


@pytest.mark.parametrize("name", ["arm.urdf", "arm.xml"])
@pytest.mark.parametrize(
    "start",
    [
        '<xacro:property name="r" value=".03"/>',
        '<xacro:arg name="r" default=".03"/><xacro:property name="r" value="$(arg r)"/>',
        '<xacro:include filename="radius.xacro"/>',
    ],
)
def test_xacro_in_a_file_of_another_name_is_expanded(
    start: str, name: str, tmp_path: Path
) -> None:
    pytest.importorskip("xacro")
    included = IN_XACRO.format('<xacro:property name="r" value=".03"/>')
    (tmp_path / "radius.xacro").write_text(included)
    body = urdf('<sphere radius="${r}"/>').partition(">")[2].removesuffix("</robot>")
    model = convert(tmp_path, IN_XACRO.format(start + body), name)
    np.testing.assert_allclose(model.geom_size[:, 0], 0.03)


@pytest.mark.parametrize("tag", ["gazebo", "transmission", "ros2_control"])
def test_packages_that_only_a_simulator_reads_are_not_searched(
    tag: str, tmp_path: Path
) -> None:
    """JAKA's URDF names a package of MoveIt for the plugin of Gazebo."""
    part = f"<{tag}><parameters>$(find moveit_of_others)/a.yaml</parameters></{tag}></robot>"
    assert convert(tmp_path, urdf().replace("</robot>", part)).njnt == 5


def test_expanded_xacro_that_keeps_the_namespace_is_plain_urdf(tmp_path: Path) -> None:
    body = urdf().partition(">")[2].removesuffix("</robot>")
    (tmp_path / "arm.urdf").write_text(IN_XACRO.format(body))
    with pytest.raises(UserError, match=r"--xacro needs a \.xacro file"):
        as_mjcf(tmp_path / "arm.urdf", tmp_path / "out", arguments=["a:=1"])
    assert convert(tmp_path, IN_XACRO.format(body)).njnt == 5


@pytest.mark.parametrize("place", ["elsewhere/parts", "./elsewhere/parts/", "~/parts"])
def test_a_package_is_given_by_a_relative_folder(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("xacro")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "elsewhere"))
    parts = tmp_path / "elsewhere" / "parts"
    parts.mkdir(parents=True)
    (parts / "radius.xacro").write_text(
        IN_XACRO.format('<xacro:property name="r" value=".03"/>')
    )
    body = urdf('<sphere radius="${r}"/>').partition(">")[2].removesuffix("</robot>")
    include = '<xacro:include filename="$(find parts)/radius.xacro"/>'
    file = Path("a/deep/down/here/now/robot.urdf.xacro")
    file.parent.mkdir(parents=True)
    file.write_text(IN_XACRO.format(include + body))
    model, _ = as_mjcf(file, tmp_path / "out", packages=[f"parts={place}"])
    assert mujoco.MjModel.from_xml_path(str(model)).ngeom == 5
    with pytest.raises(UserError, match=r"there is no folder .*nowhere"):
        as_mjcf(file, tmp_path / "again", packages=["parts=nowhere"])


def test_textures_that_are_not_drawn_are_named(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box([0.1, 0.1, 0.1])
    image = Image.new("RGB", (4, 4), (200, 100, 0))
    box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), image=image)
    box.export(tmp_path / "box.glb")
    material = '<material name="m"><texture filename="wood.png"/></material></visual>'
    text = urdf('<mesh filename="box.glb"/>').replace("</visual>", material)
    (tmp_path / "arm.urdf").write_text(text)
    _, note = as_mjcf(tmp_path / "arm.urdf", tmp_path / "out")
    assert note.endswith("textures drawn as one colour: wood.png, box.glb")
    (tmp_path / "arm.urdf").write_text(urdf())
    assert "texture" not in as_mjcf(tmp_path / "arm.urdf", tmp_path / "plain")[1]
