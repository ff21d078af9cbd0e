"""Ray caster: batches, threads, colours, anti-aliasing, cameras, lights, and refused input."""

import mujoco
import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.world.render import Raycaster
from tests.world.render.raycast_scenes import (
    CAMERA,
    every_primitive,
    random_states,
    robot_scene,
)

SMALL = 40


def test_same_bytes_at_any_batch_size_and_thread_count() -> None:
    scene = robot_scene("irb120")
    states = random_states(scene.model, 9, seed=1)
    one = Raycaster(scene.model, scene.camera, SMALL, SMALL)
    three = Raycaster(scene.model, scene.camera, SMALL, SMALL, num_threads=3)
    expected = one.draw(states.geom_xpos, states.geom_xmat)
    assert len(np.unique(expected.reshape(-1, 3), axis=0)) > 10
    np.testing.assert_array_equal(
        three.draw(states.geom_xpos, states.geom_xmat), expected
    )
    for e in range(9):
        alone = three.draw(states.geom_xpos[e : e + 1], states.geom_xmat[e : e + 1])
        np.testing.assert_array_equal(alone[0], expected[e])


def test_float32_poses() -> None:
    states = random_states(every_primitive(), 3, seed=1)
    caster = Raycaster(states.model, CAMERA, SMALL, SMALL)
    expected = caster.draw(states.geom_xpos, states.geom_xmat)
    drawn = caster.draw(
        states.geom_xpos.astype(np.float32), states.geom_xmat.astype(np.float32)
    )
    np.testing.assert_array_equal(drawn, expected)


def test_alpha_zero_hides_moving_and_fixed_geoms() -> None:
    states = random_states(every_primitive(), 2, seed=1)
    model = states.model
    caster = Raycaster(model, CAMERA, SMALL, SMALL)
    seen = caster.trace(states.geom_xpos, states.geom_xmat).geom
    table, ball = (
        1,
        int(np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE)[0]),
    )
    assert (seen == table).any()
    assert (seen == ball).any()
    rgba = np.repeat(caster.geom_rgba[None], 2, axis=0)
    rgba[1, [table, ball], 3] = 0
    hidden = caster.trace(states.geom_xpos, states.geom_xmat, rgba).geom
    np.testing.assert_array_equal(hidden[0], seen[0])
    assert not np.isin(hidden[1], [table, ball]).any()
    unhidden = caster.trace(states.geom_xpos, states.geom_xmat).geom
    np.testing.assert_array_equal(unhidden, seen)


def test_colours_are_those_of_each_environment() -> None:
    states = random_states(every_primitive(), 1, seed=1)
    caster = Raycaster(states.model, CAMERA, SMALL, SMALL)
    positions, matrices = (
        np.repeat(states.geom_xpos, 2, 0),
        np.repeat(states.geom_xmat, 2, 0),
    )
    rgba = np.repeat(caster.geom_rgba[None], 2, axis=0)
    painted = [1, 12]
    rgba[1, painted, :3] = [0, 0, 1]
    plain, blue = caster.draw(positions, matrices, rgba)
    shows = np.isin(caster.trace(states.geom_xpos, states.geom_xmat).geom[0], painted)
    assert shows.any()
    np.testing.assert_array_equal((plain != blue).any(axis=-1), shows)


def test_antialiasing_is_the_mean_of_four_rays_in_a_rotated_grid() -> None:
    states = random_states(every_primitive(), 3, seed=1)
    poses = states.geom_xpos, states.geom_xmat
    smooth = Raycaster(states.model, CAMERA, SMALL, SMALL, antialiasing=True).draw(
        *poses
    )
    fine = Raycaster(states.model, CAMERA, 4 * SMALL, 4 * SMALL).draw(*poses)
    fine = fine.reshape(3, SMALL, 4, SMALL, 4, 3).astype(int)
    total = sum(fine[:, :, row, :, column] for row, column in enumerate((1, 3, 0, 2)))
    # Rounding may put a ray on the other side of an edge.
    assert ((total + 2) // 4 == smooth).all(axis=-1).mean() > 0.999


def test_antialiasing_sees_what_lies_between_the_middles() -> None:
    """A bar a tenth of a pixel wide, between two columns of rays, darkens its pixels."""
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco><visual><headlight ambient="1 1 1" diffuse="0 0 0"/></visual><worldbody>
      <camera name="{CAMERA}" pos="0 0 1" fovy="90"/>
      <geom type="plane" size="9 9 1" rgba="1 1 1 1"/>
      <geom type="box" size=".01 9 .01" pos=".095 0 0" rgba="0 0 0 1"/>
    </worldbody></mujoco>""")
    positions, matrices = model.geom_pos[None], np.tile(np.eye(3).reshape(9), (1, 2, 1))
    sharp = Raycaster(model, CAMERA, 8, 8).draw(positions, matrices)
    smooth = Raycaster(model, CAMERA, 8, 8, antialiasing=True).draw(positions, matrices)
    assert sharp.min() == 255
    assert (smooth[0, :, 4] == 191).all()


def test_camera_of_each_environment() -> None:
    states = random_states(every_primitive(), 3, seed=1)
    caster = Raycaster(states.model, CAMERA, SMALL, SMALL)
    poses = states.geom_xpos, states.geom_xmat
    views = np.repeat(caster.view[None], 3, axis=0)
    np.testing.assert_array_equal(caster.draw(*poses, views=views), caster.draw(*poses))
    views[1, :3] += [0.1, -0.2, 0.1]
    moved = every_primitive()
    moved.cam_pos[0] = views[1, :3]
    expected = Raycaster(moved, CAMERA, SMALL, SMALL).draw(*poses)
    np.testing.assert_array_equal(caster.draw(*poses, views=views)[1], expected[1])


def test_lights_of_each_environment() -> None:
    states = random_states(every_primitive(), 2, seed=1)
    caster = Raycaster(states.model, CAMERA, SMALL, SMALL)
    poses = states.geom_xpos, states.geom_xmat
    lamps = np.repeat(caster.lamps[None], 2, axis=0)
    lamps[1, 3] = [0, 0, 1]
    lit = caster.draw(*poses, lamps=lamps)
    np.testing.assert_array_equal(lit[0], caster.draw(*poses)[0])
    model = every_primitive()
    model.light_dir[0] = [0, 0, -1]
    np.testing.assert_array_equal(
        lit[1], Raycaster(model, CAMERA, SMALL, SMALL).draw(*poses)[1]
    )


def test_nothing_in_sight_is_background() -> None:
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><camera name='{CAMERA}'/>"
        "<geom type='sphere' size='.1' pos='0 0 5'/></worldbody></mujoco>"
    )
    caster = Raycaster(model, CAMERA, 8, 8, background=(1.0, 0.5, 0.0))
    image = caster.draw(np.array([[[0.0, 0, 5]]]), np.eye(3).reshape(1, 1, 9))
    assert (image == [255, 128, 0]).all()


def test_geom_group_that_is_not_drawn() -> None:
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><camera name='{CAMERA}' pos='0 0 1'/>"
        "<geom type='sphere' size='.1' group='3'/></worldbody></mujoco>"
    )
    positions, matrices = np.zeros((1, 1, 3)), np.eye(3).reshape(1, 1, 9)
    assert (Raycaster(model, CAMERA, 8, 8).trace(positions, matrices).geom == -1).all()
    shown = (
        Raycaster(model, CAMERA, 8, 8, geom_groups=(3,)).trace(positions, matrices).geom
    )
    assert (shown == 0).any()


@pytest.mark.parametrize(
    ("options", "names"),
    [
        ({"width": 0}, ["width", "1 to", "0"]),
        ({"height": -3}, ["height", "-3"]),
        ({"num_threads": 0}, ["num_threads"]),
        ({"camera": "eyes"}, ["camera 'eyes'", "Did you mean 'eye'"]),
        ({"camera": 7}, ["Camera 7"]),
    ],
)
def test_bad_arguments(options: dict[str, object], names: list[str]) -> None:
    arguments = {"camera": CAMERA, "width": 8, "height": 8} | options
    with pytest.raises(UserError) as error:
        Raycaster(every_primitive(), **arguments)
    assert all(name in str(error.value) for name in names)


@pytest.mark.parametrize(
    ("parts", "names"),
    [
        (
            "<body><joint/><geom size='.1'/><camera name='eye'/></body>",
            ["'eye'", "moves"],
        ),
        (
            "<camera name='eye' projection='orthographic' fovy='1'/>",
            ["'eye'", "orthographic"],
        ),
        ("<camera name='eye'/><light name='lamp'/>", ["directional"]),
        (
            "<camera name='eye'/><geom name='hill' type='hfield' hfield='h'/>",
            ["'hill'", "hfield"],
        ),
    ],
)
def test_models_that_cannot_be_drawn(parts: str, names: list[str]) -> None:
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><asset><hfield name='h' nrow='2' ncol='2' size='1 1 1 1'/></asset>"
        f"<worldbody>{parts}</worldbody></mujoco>"
    )
    with pytest.raises(UserError) as error:
        Raycaster(model, "eye", 8, 8)
    assert all(name in str(error.value) for name in names)
