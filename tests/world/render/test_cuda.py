"""Images of CPU and GPU are equal to the byte: under Numba's simulator, and on a GPU."""

import json
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

MOST_REGISTERS = 80
"""Registers per thread with which a multiprocessor of an H200 holds 24 warps of its 64."""


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
    # 2 images of 5 x 5 pixels: neither warps nor blocks are full. The first scene has no mesh.
    compare(side=5, states=2, simulate=True)


def test_compiled_kernels_fit_the_gpu() -> None:
    """For compute capability 9.0: nothing fused, no float64, no memory in place of registers."""
    pytest.importorskip("numba_cuda", reason="numba-cuda is not installed")
    pathfinder = pytest.importorskip("cuda.pathfinder", reason="numba-cuda is not installed")
    for library in ("nvvm", "nvrtc"):
        try:
            pathfinder.load_nvidia_dynamic_lib(library)
        except pathfinder.DynamicLibNotFoundError:
            pytest.skip(f"numba-cuda's compiler needs {library}")
    done = subprocess.run(
        [sys.executable, "-m", "tests.world.render.cuda_ptx"],
        cwd=ROOT,
        env=os.environ | {"NUMBA_ENABLE_CUDASIM": "0"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    kernels = json.loads(done.stdout)
    assert set(kernels) == {"fill_kernel", "project_kernel", "mask_kernel", "draw_kernel"}
    for name, found in kernels.items():
        assert not found["wrong"], name
        assert found.get("spilled", 0) == 0, name
        assert found.get("registers", 0) <= MOST_REGISTERS, name


@pytest.mark.cuda
@pytest.mark.skipif(not numba.cuda.is_available(), reason="no CUDA device")
def test_images_equal_the_cpus() -> None:
    compare(side=64, states=64, simulate=False)


@pytest.mark.skipif(numba.cuda.is_available(), reason="there is a CUDA device")
def test_missing_device_is_named() -> None:
    with pytest.raises(UserError, match="no CUDA device"):
        CudaRaycaster(every_primitive(), CAMERA, 8, 8)
