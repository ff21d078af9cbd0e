"""Distance, angle, success and reward."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from knowarm.world.tasks.reward import is_success, measure, paper_reward


def rows(rotation: Rotation) -> np.ndarray:
    return np.ascontiguousarray(rotation.as_matrix().reshape(-1, 9))


def test_distance_is_euclidean() -> None:
    eye = np.eye(3).reshape(1, 9)
    distance, angle = measure(
        np.array([[1.0, 2.0, 3.0]]), eye, np.array([[4.0, 6.0, 3.0]]), eye, False
    )
    assert distance[0] == pytest.approx(5.0)
    assert angle[0] == 0.0


def test_angle_is_the_geodesic_one_everywhere_between_0_and_180() -> None:
    generator = np.random.default_rng(0)
    a = Rotation.random(500, generator)
    turn = np.concatenate(
        [[1e-9, 1e-4, np.pi - 1e-4, np.pi], generator.uniform(0, np.pi, 496)]
    )
    axes = generator.normal(size=(500, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    b = a * Rotation.from_rotvec(axes * turn[:, None])
    zero = np.zeros((500, 3))
    _, angle = measure(zero, rows(a), zero, rows(b), False)
    assert np.allclose(angle, np.degrees(turn), atol=1e-6)


@given(st.floats(-180, 180), st.floats(0, 180))
def test_ignoring_roll_leaves_the_angle_between_approach_axes(
    roll: float, tilt: float
) -> None:
    grasp = Rotation.from_euler("zyx", [[20, 50, -70]], degrees=True)
    tcp = grasp * Rotation.from_euler("xz", [[tilt, roll]], degrees=True)
    zero = np.zeros((1, 3))
    _, angle = measure(zero, rows(tcp), zero, rows(grasp), True)
    assert angle[0] == pytest.approx(tilt, abs=1e-6)


def test_reward_is_the_paper_s() -> None:
    distance, angle = (
        np.array([0.04, 0.04, 0.5, 0.049]),
        np.array([10.0, 20.0, 70.0, 14.9]),
    )
    success = is_success(distance, angle, 0.05, 15.0)
    assert success.tolist() == [True, False, False, True]
    assert paper_reward(distance, angle, success) == pytest.approx(
        [100.0, -2 * 0.04**2 - 20 / 70, -2 * 0.25 - 1.0, 100.0]
    )


def test_thresholds_are_strict() -> None:
    assert not is_success(np.array([0.05]), np.array([1.0]), 0.05, 15.0)[0]
    assert not is_success(np.array([0.01]), np.array([15.0]), 0.05, 15.0)[0]
