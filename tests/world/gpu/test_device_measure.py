"""Distance and angle of tensors are those of the CPU's compiled loop."""

import numpy as np
import pytest
import torch
from knowarm.world.gpu.measure import measure
from scipy.spatial.transform import Rotation

from knowarm.world.tasks.reward import measure as measure_on_cpu


def frames(count: int) -> tuple[np.ndarray, ...]:
    """Random pairs of frames, among them equal, opposite and nearly equal ones."""
    generator = np.random.default_rng(0)
    first = Rotation.random(count, random_state=0)
    turns = Rotation.random(count, random_state=1).as_rotvec()
    turns[:20] *= np.logspace(-6, 0, 20)[:, None]
    turns[20] = 0
    turns[21] = [np.pi, 0, 0]
    second = first * Rotation.from_rotvec(turns)
    positions = generator.normal(size=(2, count, 3))
    return positions[0], first.as_matrix(), positions[1], second.as_matrix()


@pytest.mark.parametrize("ignore_roll", [False, True])
@pytest.mark.parametrize(("dtype", "error"), [(torch.float64, 1e-6), (torch.float32, 2e-2)])
def test_measures_agree(dtype: torch.dtype, error: float, ignore_roll: bool) -> None:
    a, turn_a, b, turn_b = frames(300)
    distance, angle = measure_on_cpu(
        a, turn_a.reshape(-1, 9), b, turn_b.reshape(-1, 9), ignore_roll
    )
    tensors = [torch.as_tensor(array, dtype=dtype) for array in (a, turn_a, b, turn_b)]
    got_distance, got_angle = measure(*tensors, ignore_roll)
    assert got_distance.dtype == got_angle.dtype == dtype
    assert got_distance.numpy() == pytest.approx(distance, rel=1e-6)
    assert got_angle.numpy() == pytest.approx(angle, abs=error)
    assert angle.min() < 1e-3
    assert angle.max() > 150
