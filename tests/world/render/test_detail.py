"""Levels of detail: size and place of simplified meshes' triangles, their images; the cache."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import scipy
from numpy.typing import NDArray

from benchmarks.images import ssim, stray_share
from knowarm.world.render import Raycaster
from knowarm.world.render.mesh_simplification import Mesh, simplified
from tests.world.render.raycast_scenes import CAMERA, random_states, torus

SIDE = 64


@pytest.fixture(autouse=True)
def _cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KNOWARM_CACHE", str(tmp_path / "cache"))


def flat_shaded(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Mesh:
    """A mesh whose corners have their triangle's normal."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return Mesh(
        vertices.astype(np.float32),
        faces.astype(np.int32),
        np.repeat(normal[:, None], 3, axis=1).astype(np.float32),
    )


def sheet(cells: int) -> Mesh:
    """An open, flat square of side 1 in cells x cells squares."""
    x, y = np.meshgrid(*[np.linspace(0, 1, cells + 1)] * 2, indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    i, j = (
        grid.ravel() for grid in np.meshgrid(*[np.arange(cells)] * 2, indexing="ij")
    )
    a, b = i * (cells + 1) + j, (i + 1) * (cells + 1) + j
    faces = np.concatenate(
        [np.stack([a, b, b + 1], axis=1), np.stack([a, b + 1, a + 1], axis=1)]
    )
    return flat_shaded(vertices, faces)


def test_simplified_mesh_has_triangles_of_the_size_and_stays_near() -> None:
    full = flat_shaded(*torus(120, 60))
    area = np.linalg.norm(
        np.cross(*np.diff(full.vertex[full.face], axis=1).swapaxes(0, 1)), axis=1
    )
    tree = scipy.spatial.cKDTree(full.vertex)
    for side in (2**-7, 2**-6, 2**-5):
        mesh = simplified(full, side * 1.1)
        assert len(mesh.face) == pytest.approx(area.sum() / 2 / side**2, rel=0.1)
        assert tree.query(mesh.vertex)[0].max() < 0.007


def test_flat_open_mesh_stays_flat() -> None:
    mesh = simplified(sheet(40), 0.1)
    assert len(mesh.face) < 300
    np.testing.assert_allclose(np.ptp(mesh.vertex, axis=0), [1, 1, 0], atol=0.03)
    np.testing.assert_allclose(np.abs(mesh.normal[..., 2]), 1.0, atol=1e-6)


def test_a_mesh_without_smaller_triangles_is_kept() -> None:
    full = flat_shaded(*torus(20, 10))
    assert simplified(full, 0.001) is full


def test_cache_returns_the_same_bytes_and_survives_damage(tmp_path: Path) -> None:
    full = flat_shaded(*torus(40, 20))
    first = simplified(full, 0.04)
    (file,) = (tmp_path / "cache" / "meshes").iterdir()
    for content in (file.read_bytes(), b"", b"PK\x03\x04 damaged"):
        file.write_bytes(content)
        again = simplified(full, 0.041)
        assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert len(list(file.parent.iterdir())) == 1
    simplified(full, 0.08)
    assert len(list(file.parent.iterdir())) == 2


def mesh_arm(rings: int = 120, sides: int = 60) -> mujoco.MjModel:
    """An arm of two joints with fine tori for links, one of them mirrored and scaled."""
    spec = mujoco.MjSpec.from_string(f"""
    <mujoco>
      <visual><headlight ambient=".3 .3 .3" diffuse=".4 .4 .4" specular="0 0 0"/></visual>
      <worldbody>
        <light type="directional" dir="-.3 .4 -.9" diffuse=".4 .4 .3" specular="0 0 0"/>
        <camera name="{CAMERA}" pos="1.3 -1.1 1.2" xyaxes=".65 .76 .02 -.36 .32 .87" fovy="40"/>
        <geom type="plane" size="0 0 .1" rgba=".6 .6 .6 1"/>
        <body pos="0 0 .2"><joint axis="0 0 1" range="-3 3"/><geom size=".05"/>
          <body name="upper" pos="0 0 .2"><joint axis="0 1 0" range="-2 2"/><geom size=".05"/>
            <body name="lower" pos=".2 0 .2"><joint axis="0 1 0" range="-2 2"/><geom size=".05"/>
      </body></body></body></worldbody>
    </mujoco>""")
    vertices, triangles = torus(rings, sides)
    for name, scale in (("plain", [1, 1, 1]), ("mirrored", [-1, 1.2, 0.8])):
        spec.add_mesh(
            name=name,
            uservert=vertices.ravel().tolist(),
            userface=triangles.ravel().tolist(),
            scale=scale,
        )
    for body, mesh, colour in (
        ("world", "plain", [0.9, 0.8, 0.2, 1]),
        ("upper", "plain", [0.8, 0.2, 0.2, 1]),
        ("upper", "mirrored", [0.2, 0.3, 0.9, 1]),
        ("lower", "mirrored", [0.2, 0.8, 0.4, 1]),
    ):
        parent = spec.worldbody if body == "world" else spec.body(body)
        parent.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=mesh,
            rgba=colour,
            pos=[0, 0.15, 0.1],
        )
    return spec.compile()


@pytest.mark.parametrize("antialiasing", [False, True])
def test_images_resemble_those_of_full_meshes(antialiasing: bool) -> None:
    model = mesh_arm()
    states = random_states(model, 30, seed=3)
    poses = states.geom_xpos, states.geom_xmat
    casters = [
        Raycaster(
            model, CAMERA, SIDE, SIDE, antialiasing=antialiasing, mesh_triangle_px=size
        )
        for size in (None, 0.71)
    ]
    full, simple = (caster.draw(*poses) for caster in casters)
    assert np.mean([ssim(a, b) for a, b in zip(full, simple, strict=True)]) >= 0.98
    assert not np.array_equal(full, simple)
    if not antialiasing:
        shown = [caster.trace(*poses).geom > 0 for caster in casters]
        assert stray_share(*shown) <= 0.001
    counts = [len(caster.scenery.meshes.face) for caster in casters]
    assert counts[0] == 2 * 14_400
    assert counts[1] < 6_000


def test_larger_images_have_finer_meshes() -> None:
    counts = [
        len(
            Raycaster(
                mesh_arm(), CAMERA, side, side, mesh_triangle_px=0.71
            ).scenery.meshes.face
        )
        for side in (32, 64, 128)
    ]
    assert counts[0] < counts[1] < counts[2] < 2 * 14_400
