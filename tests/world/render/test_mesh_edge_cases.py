"""Unusual meshes: shared, scaled, mirrored, textured, flat, empty, huge, and without normals."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from knowarm.errors import UserError
from knowarm.world.render import Raycaster
from knowarm.world.render.scenery import read_scenery
from knowarm.world.scene.mjcf import read_mjcf
from tests.world.render.raycast_scenes import CAMERA, random_states, torus
from tests.world.render.test_geometry import agreement

SIDE = 48


@pytest.fixture(autouse=True)
def _cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KNOWARM_CACHE", str(tmp_path / "cache"))


def model_of(
    meshes: str,
    geoms: str,
    assets: str = "",
    vertices: NDArray[np.float64] | None = None,
) -> mujoco.MjModel:
    """Free bodies of one mesh geom each; ``meshes`` are attributes of the torus's copies."""
    points, faces = torus(24, 12)
    numbers = " ".join(
        f"{x:.6f}" for x in (points if vertices is None else vertices).ravel()
    )
    indices = " ".join(map(str, faces.ravel()))
    assets += "".join(
        f'<mesh vertex="{numbers}" face="{indices}" {mesh}/>'
        for mesh in meshes.split("|")
        if mesh
    )
    bodies = "".join(
        f"""<body pos="{0.4 * (k % 3) - 0.4} {0.3 * (k // 3) - 0.2} .4"><freejoint/>
        <geom type="mesh" contype="0" conaffinity="0" mass="1" {geom}/></body>"""
        for k, geom in enumerate(geoms.split("|"))
    )
    return mujoco.MjModel.from_xml_string(f"""
    <mujoco><asset>{assets}</asset><worldbody>
      <light type="directional" dir="-.3 .4 -.9" diffuse=".4 .4 .3" specular="0 0 0"/>
      <camera name="{CAMERA}" pos="1.3 -1.1 1.2" xyaxes=".65 .76 .02 -.36 .32 .87" fovy="50"/>
      {bodies}
    </worldbody></mujoco>""")


def draw(model: mujoco.MjModel, size: float | None) -> NDArray[np.uint8]:
    states = random_states(model, 3, seed=1)
    caster = Raycaster(
        model, CAMERA, SIDE, SIDE, antialiasing=True, mesh_triangle_px=size
    )
    return caster.draw(states.geom_xpos, states.geom_xmat)


def resembles(model: mujoco.MjModel) -> None:
    full, simple = (draw(model, size).astype(int) for size in (None, 0.71))
    assert (full.max(axis=-1) > 0).mean() > 0.005
    assert np.abs(full - simple).mean() < 0.5


def test_scaled_and_mirrored_meshes() -> None:
    model = model_of(
        'name="a"|name="b" scale="-1 1 1"|name="c" scale="-1.5 .5 -.7"|name="d" scale="1 -1 -1"',
        'mesh="a"|mesh="b"|mesh="c"|mesh="d"',
    )
    assert agreement(random_states(model, 20, seed=2), CAMERA) >= 0.999
    resembles(model)


def test_mesh_shared_by_many_geoms_is_stored_once() -> None:
    model = model_of('name="a"', "|".join(['mesh="a"'] * 6))
    caster = Raycaster(model, CAMERA, SIDE, SIDE)
    assert len(caster.scenery.meshes.face) == 24 * 12 * 2
    assert len(np.unique(caster.scenery.meshes.span, axis=0)) == 1
    resembles(model)


def test_a_mesh_shown_twice_at_one_place_is_drawn_once() -> None:
    geom = 'mesh="a" rgba=".2 .5 .9 1"'
    other = '/><geom type="mesh" contype="0" conaffinity="0" mass="1" '
    once, twice, coloured, apart = (
        model_of('name="a"', geoms)
        for geoms in (
            geom,
            geom + other + geom,
            geom + other + geom.replace(".9", ".1"),
            geom + other + geom + ' pos="0 0 .1"',
        )
    )
    counts = [len(read_scenery(m, (0,)).moving) for m in (once, twice, coloured, apart)]
    assert counts == [1, 1, 2, 2]
    np.testing.assert_array_equal(draw(once, None), draw(twice, None))


def test_meshes_of_hidden_groups_are_not_stored() -> None:
    model = model_of('name="a"|name="b" scale="2 2 2"', 'mesh="a"|mesh="b" group="3"')
    assert len(Raycaster(model, CAMERA, SIDE, SIDE).scenery.meshes.face) == 24 * 12 * 2


def test_mesh_without_normals_or_faces() -> None:
    cloud = '<mesh name="cloud" vertex="0 0 0 .3 0 0 0 .3 0 .05 .05 .3 .2 .2 .2"/>'
    model = model_of("", 'mesh="cloud"|mesh="cloud"', cloud)
    assert agreement(random_states(model, 10, seed=2), CAMERA) >= 0.999
    resembles(model)


def test_flat_mesh_is_drawn_from_both_sides() -> None:
    flat = (
        '<mesh name="flat" inertia="shell" vertex="-.2 -.2 0 .2 -.2 0 .2 .2 0 -.2 .2 0" '
        'face="0 1 2 0 2 3"/>'
    )
    model = model_of("", 'mesh="flat"|mesh="flat" euler="180 0 0"', flat)
    assert agreement(random_states(model, 10, seed=2), CAMERA) >= 0.99
    resembles(model)


@pytest.mark.parametrize(
    ("mesh", "words"),
    [
        ('vertex="-.2 -.2 0 .2 -.2 0 .2 .2 0 -.2 .2 0" face="0 1 2 0 2 3"', "coplanar"),
        ('vertex="0 0 0 1 0 0 0 1 0"', "vert"),
        ('file="empty.stl"', "empty.stl"),
        ('file="missing.obj"', "missing.obj"),
    ],
)
def test_flat_or_empty_meshes_of_a_file_are_refused_by_name(
    mesh: str, words: str, tmp_path: Path
) -> None:
    (tmp_path / "empty.stl").write_bytes(bytes(80) + bytes(4))
    file = tmp_path / "arm.xml"
    file.write_text(
        f'<mujoco><asset><mesh name="part" {mesh}/></asset><worldbody><body>'
        '<geom type="mesh" mesh="part"/></body></worldbody></mujoco>'
    )
    with pytest.raises(UserError, match=r"arm\.xml.*does not compile") as error:
        read_mjcf(file, "Robot 'arm'")
    assert words in str(error.value)


def test_texture_is_drawn_in_its_mean_colour() -> None:
    assets = (
        '<texture name="checker" type="2d" builtin="checker" rgb1="1 0 0" rgb2="0 0 1" width="64" '
        'height="64"/><material name="look" texture="checker" rgba=".5 1 1 1"/>'
    )
    model = model_of('name="a"', 'mesh="a" material="look"', assets)
    colour = Raycaster(model, CAMERA, SIDE, SIDE).geom_rgba[0]
    np.testing.assert_allclose(colour, [0.25, 0, 0.5, 1], atol=0.01)


@pytest.mark.slow
def test_two_hundred_thousand_triangles() -> None:
    vertices, faces = torus(400, 250)
    spec = mujoco.MjSpec.from_string(
        f'<mujoco><worldbody><camera name="{CAMERA}" pos="0 -1.2 .8" xyaxes="1 0 0 0 .55 .83" '
        'fovy="40"/><body name="part"><freejoint/></body></worldbody></mujoco>'
    )
    spec.add_mesh(
        name="huge", uservert=vertices.ravel().tolist(), userface=faces.ravel().tolist()
    )
    spec.body("part").add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH, meshname="huge", contype=0, conaffinity=0
    )
    model = spec.compile()
    assert model.nmeshface == 200_000
    caster = Raycaster(
        model, CAMERA, SIDE, SIDE, antialiasing=True, mesh_triangle_px=0.71
    )
    assert len(caster.scenery.meshes.face) < 4_000
    resembles(model)
