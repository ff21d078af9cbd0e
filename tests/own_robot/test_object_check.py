"""Checks of the objects of the choose task."""

from pathlib import Path

import pytest

from knowarm.errors import UserError
from knowarm.own_robot.object_check import check_objects
from knowarm.own_robot.robot_check import check_robot
from knowarm.world.objects import find_targets
from knowarm.world.scene.scene import load_scene
from tests.world.helpers import EXAMPLES

pytestmark = pytest.mark.usefixtures("unfenced")


def test_objects_that_can_be_reached_and_told_apart_pass() -> None:
    checks = check_objects("irb120", "choose", ["mug", "can", "book", "bell"])
    assert [check for check in checks if not check.ok] == []
    assert {"reach of mug", "book in the image", "any two objects differ"} <= {
        check.name for check in checks
    }


def test_an_object_is_drawn_with_all_its_parts() -> None:
    parts = ["bottle.neck", "bottle.stopper", "clock.bell", "clock.rim"]
    checks = {check.name: check for check in check_objects("irb120", "purpose", parts)}
    assert [check for check in checks.values() if not check.ok] == []
    shown = {"bottle in the image", "clock in the image"}
    assert {f"reach of {part}" for part in parts} | shown < {*checks}
    assert "bottle and clock" in checks["any two objects differ"].found


def test_two_objects_of_one_shape_are_named(tmp_path: Path) -> None:
    for name in ("one", "other"):
        text = (EXAMPLES / "bowl.toml").read_text()
        mjcf = (EXAMPLES / "bowl.toml").parent / "bowl.xml"
        lines = [
            line for line in text.splitlines() if not line.startswith(("mjcf", "name"))
        ]
        (tmp_path / f"{name}.toml").write_text(
            "\n".join([f'name = "{name}"', f'mjcf = "{mjcf}"', *lines])
        )
    files = [str(tmp_path / f"{name}.toml") for name in ("one", "other")]
    checks = {
        check.name: check
        for check in check_objects("irb120", "choose", [*files, "can", "bell"])
    }
    assert not checks["any two objects differ"].ok
    assert "one and other" in checks["any two objects differ"].found


def test_a_scene_that_cannot_be_built_is_the_only_check() -> None:
    (check,) = check_objects("irb120", "choose", ["mug", "mugg", "can", "bell"])
    assert not check.ok
    assert "mugg" in check.found


def test_objects_to_lift_are_checked_without_fingers() -> None:
    checks = check_objects("irb120", "lift", ["mug", "bottle"])
    assert [check for check in checks if not check.ok] == []


def test_an_easier_orientation_is_that_of_the_check() -> None:
    options = {"success_angle_deg": 1e-12}
    checks = {
        c.name: c for c in check_objects("irb120", "lift", ["mug", "bottle"], **options)
    }
    assert not checks["reach of mug"].ok


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("mug.obj", "'mug.obj', which is a mesh.* docs/how-to/own-object.md"),
        ("scans/Mug.STL", "which is a mesh"),
        ("mug.glb", "which is a mesh"),
        ("mug.urdf", "a model in the format .urdf"),
        ("mug.urdf.xacro", "a model in the format .xacro"),
        ("mug.sdf", "a model in the format .sdf"),
        ("ycb/mug.xml", "Give 'ycb/mug.toml', with the field mjcf = \"mug.xml\""),
    ],
)
def test_a_target_that_is_no_description_is_told_what_one_is(
    name: str, words: str
) -> None:
    with pytest.raises(UserError, match=words):
        find_targets([name])


MUG = """<mujoco><asset><mesh name="m" vertex="-40 -40 0 40 -40 0 0 40 0 0 0 90" {}/></asset>
<worldbody>{}<body name="mug"><geom name="mug" type="mesh" mesh="m"/>
<site name="{}" pos="0 0 .05" quat="0 1 0 0"/></body></worldbody></mujoco>"""
METRES = 'scale=".001 .001 .001"'


def write_object(folder: Path, text: str, mjcf: str = "cup.xml") -> str:
    (folder / mjcf).write_text(text)
    (folder / "cup.toml").write_text(f'mjcf = "{mjcf}"\ncoloured_geoms = ["mug"]\n')
    return str(folder / "cup.toml")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (MUG.format("", "", "grasp"), 'millimetres needs scale="0.001 0.001 0.001"'),
        (
            MUG.format('scale="1e-6 1e-6 1e-6"', "", "grasp"),
            "diameter of .* m, and lengths are in metres",
        ),
        (
            MUG.format(METRES, '<geom name="stand" size=".1"/>', "grasp"),
            "it holds 1, and outside of them the geoms stand",
        ),
        (MUG.format(METRES, "<body/>", "grasp"), "it holds 2, and outside"),
        (MUG.format(METRES, "", "top"), "Its sites: top. Add the site: z is the appr"),
    ],
)
def test_objects_that_are_wrong_are_refused_by_the_cause(
    text: str, words: str, tmp_path: Path
) -> None:
    with pytest.raises(UserError, match=words):
        load_scene("irb120", (write_object(tmp_path, text),))


@pytest.mark.parametrize("name", ["cup.obj", "cup.urdf"])
def test_a_description_of_a_mesh_or_urdf_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=f"Target 'cup': mjcf is .*{name}"):
        load_scene("irb120", (write_object(tmp_path, "", name),))


def test_floor_and_light_of_an_objects_file_are_left_out(tmp_path: Path) -> None:
    floor = '<geom type="plane" size="1 1 .1"/><light pos="0 0 1"/>'
    bare = load_scene(
        "irb120", (write_object(tmp_path, MUG.format(METRES, "", "grasp")),)
    )
    text = MUG.format(METRES, floor, "grasp")
    scene = load_scene("irb120", (write_object(tmp_path, text),))
    assert scene.model.ngeom == bare.model.ngeom
    assert scene.model.nlight == bare.model.nlight


def test_textures_of_an_object_are_named(tmp_path: Path) -> None:
    texture = '<texture name="t" type="2d" builtin="checker" width="9" height="9"/>'
    text = MUG.format(METRES, "", "grasp").replace(
        "</asset>", f'{texture}<material name="m" texture="t"/></asset>'
    )
    file = write_object(tmp_path, text.replace('mesh="m"/>', 'mesh="m" material="m"/>'))
    found = next(check_robot("irb120", [file])).found
    assert found.endswith("textures are drawn as their mean colour: cup")
    file = write_object(tmp_path, MUG.format(METRES, "", "grasp"))
    assert "texture" not in next(check_robot("irb120", [file])).found
