"""Program that compares images of the CPU and CUDA ray casters; it fails if they differ.

It is a program of its own because an environment variable selects Numba's simulator before Numba
is first imported:
``NUMBA_ENABLE_CUDASIM=1 python -m tests.world.render.cuda_images SIDE STATES``.
"""

import sys

import numpy as np
from numba import cuda

from knowarm.world.render import Raycaster
from knowarm.world.render.cuda import CudaRaycaster
from tests.world.render.raycast_scenes import CAMERA, every_primitive, mesh_scene, random_states


def main(side: int, count: int) -> None:
    """Draw scenes with both ray casters, with all options, and compare the bytes."""
    for make in (every_primitive, lambda: mesh_scene(6, 4)):
        states = random_states(make(), count, seed=1)
        poses = states.geom_xpos, states.geom_xmat
        on_device = [cuda.to_device(np.ascontiguousarray(pose)) for pose in poses]
        for smooth in (False, True):
            host = Raycaster(states.model, CAMERA, side, side, antialiasing=smooth)
            device = CudaRaycaster(states.model, CAMERA, side, side, antialiasing=smooth)
            rgba = np.repeat(host.geom_rgba[None], count, axis=0)
            rgba[0, 0, :3] = [0.1, 0.9, 0.1]
            rgba[-1, 1, 3] = 0
            views = np.repeat(host.view[None], count, axis=0)
            views[0, 0] += 0.1
            lamps = np.repeat(host.lamps[None], count, axis=0)
            lamps[-1, 3] = [0, 0, 1]
            every_second = np.arange(count) % 2 == 0
            for options in (
                {},
                {"geom_rgba": rgba},
                {"views": views},
                {"lamps": lamps},
                {"wanted": every_second},
            ):
                wanted = options.get("wanted", np.ones(count, dtype=np.bool_))
                given = {name: cuda.to_device(value) for name, value in options.items()}
                seen = {name: value for name, value in options.items() if name != "wanted"}
                expected = host.draw(*poses, **seen) * wanted[:, None, None, None]
                out = cuda.to_device(np.zeros_like(expected))
                device.draw(*on_device, out=out, **given)
                drawn = out.copy_to_host()
                wrong = (drawn != expected).any(axis=-1).mean()
                print(f"{make.__name__} smooth={smooth} {list(options)}: {wrong:.4%} differ")
                assert len(np.unique(expected)) > 10
                assert wrong == 0


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
