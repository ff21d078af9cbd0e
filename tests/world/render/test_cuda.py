"""Images of CPU and GPU are equal to the byte: under Numba's simulator, and on a GPU."""

import os
import subprocess
import sys
from pathlib import Path

import numba.cuda
import pytest

from knowarm.errors import UserError
from knowarm.world.render.cuda import CudaRaycaster
from tests.world.render.raycast_scenes import CAMERA, every_primitive

PROGRAM = "tests.world.render.cuda_images"
ROOT = Path(__file__).parents[3]


def compare(side: int, states: int, simulate: bool) -> None:
    done = subprocess.run(
        [sys.executable, "-m", PROGRAM, str(side), str(states)],
        cwd=ROOT,
        env=os.environ | {"NUMBA_ENABLE_CUDASIM": str(int(simulate))},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_simulated_images_equal_the_cpus() -> None:
    compare(side=8, states=2, simulate=True)


@pytest.mark.cuda
@pytest.mark.skipif(not numba.cuda.is_available(), reason="no CUDA device")
def test_images_equal_the_cpus() -> None:
    compare(side=64, states=64, simulate=False)


@pytest.mark.skipif(numba.cuda.is_available(), reason="there is a CUDA device")
def test_missing_device_is_named() -> None:
    with pytest.raises(UserError, match="no CUDA device"):
        CudaRaycaster(every_primitive(), CAMERA, 8, 8)
