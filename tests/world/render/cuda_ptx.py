"""Program that compiles the ray caster's kernels for compute capability 9.0, without a GPU.

It prints, as JSON, the PTX instructions of each kernel that may not occur, and with ``ptxas`` the
registers and spilled bytes: ``python -m tests.world.render.cuda_ptx``. It is a program of its own
because an environment variable may have selected Numba's simulator.
"""

import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numba import cuda, typeof, types
from numba.cuda import dispatcher

from knowarm.private_apis import no_fused_multiply_add
from knowarm.world.render import Raycaster, cuda_kernels
from tests.world.render.raycast_scenes import CAMERA, mesh_scene

FORBIDDEN = ("fma.", ".f64", ".local")
"""Fused operations, float64 arithmetic, and memory used in place of registers."""


def signatures() -> dict[str, Any]:
    """Return the types of the arguments of each kernel, as ``CudaRaycaster.draw`` passes them."""
    host = Raycaster(mesh_scene(6, 4), CAMERA, 8, 8)
    meshes, whole = host.scenery.meshes, types.int64

    def array(dtype: Any, ndim: int) -> Any:
        return types.Array(dtype, ndim, "C")

    f32, i32 = types.float32, types.int32
    record, extent, redraw = array(f32, 3), array(i32, 3), array(i32, 1)
    masks, wanted, fixed = array(types.uint64, 3), array(types.boolean, 1), whole
    grid = typeof(host.grid)
    shape = typeof(
        (host.scenery.kind, host.scenery.size, host.scenery.emission, meshes.middle, meshes.half)
    )
    triangles = typeof((meshes.vertex, meshes.face, meshes.normal, meshes.span))
    backdrop = typeof(tuple(np.ascontiguousarray(part) for part in host.stored.backdrop))
    return {
        "fill_kernel": (redraw, whole),
        "project_kernel": (
            array(i32, 1), fixed, shape, array(f32, 2), record, record, record, array(f32, 2),
            array(f32, 2), grid, record, extent, redraw, wanted,
        ),
        "mask_kernel": (extent, fixed, redraw, i32, wanted, masks),
        "draw_kernel": (
            record, extent, masks, redraw, grid, backdrop, whole, triangles, wanted,
            array(types.uint8, 4),
        ),
    }  # fmt: skip


def ptxas(ptx: str) -> dict[str, int]:
    """Assemble a kernel for sm_90; return its registers and the bytes it spills."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "kernel.ptx"
        path.write_text(ptx)
        command = ["ptxas", "-v", "-arch=sm_90", str(path), "-o", str(path.with_suffix(".cubin"))]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    numbers = {"registers": r"Used (\d+) registers", "spilled": r"(\d+) bytes spill stores"}
    return {
        name: int(re.search(pattern, done.stderr).group(1)) for name, pattern in numbers.items()
    }


def main() -> None:
    # Device functions are compiled for the current device, and there may be none.
    dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=(9, 0))
    found = {}
    for name, types_of_arguments in signatures().items():
        function = getattr(cuda_kernels, name).py_func
        with no_fused_multiply_add():
            signature = types.void(*types_of_arguments)
            ptx, _ = cuda.compile_ptx(function, signature, cc=(9, 0))
        lines = [line.strip() for line in ptx.splitlines()]
        wrong = [line for line in lines if any(word in line for word in FORBIDDEN)]
        found[name] = {"instructions": len(lines), "wrong": wrong}
        if shutil.which("ptxas"):
            found[name] |= ptxas(ptx)
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()
