"""Program that compares images of the CPU and CUDA ray casters, and the masks of geoms.

It fails if they differ.

It is a program of its own because an environment variable selects Numba's simulator before Numba
is first imported:
``NUMBA_ENABLE_CUDASIM=1 python -m tests.world.render.cuda_images SIDE STATES``.
"""

import sys

import numpy as np
from numba import cuda

from knowarm.world.render import Raycaster
from knowarm.world.render.cuda import CudaRaycaster
from knowarm.world.render.cuda_kernels import HIDDEN, WORD, mask_kernel
from tests.world.render.raycast_scenes import CAMERA, every_primitive, mesh_scene, random_states


def compare_masks(geoms: int, strips: int, rows: int) -> None:
    """Compare the masks of random rectangles of tiles with NumPy's."""
    generator, count, fixed = np.random.default_rng(geoms), 3, geoms // 3
    extent = np.zeros((count, geoms, 6), dtype=np.int32)
    for low, limit in ((2, strips), (4, rows)):
        ends = generator.integers(limit, size=(count, geoms, 2))
        extent[:, :, low : low + 2] = np.sort(ends, axis=2)
    extent[generator.random((count, geoms)) < 0.2, 0] = HIDDEN
    redraw = np.array([0, 1, 0], dtype=np.int32)
    words = -(-geoms // WORD)
    masks = cuda.to_device(np.zeros((count, strips + rows, words), dtype=np.uint64))
    wanted = cuda.to_device(np.array([True, True, False]))
    threads = count * (strips + rows) * words
    mask_kernel[-(-threads // 32), 32](
        cuda.to_device(extent), fixed, cuda.to_device(redraw), strips, wanted, masks
    )
    tiles = np.arange(strips + rows)
    across = (extent[:, None, :, 2] <= tiles[:, None]) & (tiles[:, None] <= extent[:, None, :, 3])
    tiles = tiles - strips
    down = (extent[:, None, :, 4] <= tiles[:, None]) & (tiles[:, None] <= extent[:, None, :, 5])
    expected = np.where((tiles < 0)[:, None], across, down) & (extent[:, None, :, 0] != HIDDEN)
    expected[0, :, :fixed] = False
    expected[2] = False
    found = np.unpackbits(masks.copy_to_host().view(np.uint8), axis=2, bitorder="little")
    assert expected.any()
    assert (found[:, :, :geoms] == expected).all()
    assert not found[:, :, geoms:].any()


def main(side: int, count: int) -> None:
    """Draw scenes with both ray casters, with all options, and compare the bytes."""
    for geoms in (5, WORD, WORD + 7):
        compare_masks(geoms, strips=2, rows=3)
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
                {"geom_rgba": rgba, "views": views, "lamps": lamps},
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
