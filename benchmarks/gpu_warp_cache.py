"""Compile MuJoCo Warp's kernels for a GPU that this machine does not have.

    python benchmarks/gpu_warp_cache.py CACHE [--arch 90] [--robots irb120 tiago]

Builds the simulation of each robot with launches that are noted instead of executed, and compiles
every module they need with the NVRTC that Warp contains; neither a driver nor `warp-clang.so` is
needed. A machine with a GPU loads these modules with ``WARP_CACHE_PATH=CACHE`` instead of
compiling them, if it has the same versions of Warp and MuJoCo Warp.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import torch

from knowarm.world.backends import Dynamics
from knowarm.world.backends.warp import WarpSimulator, import_warp
from knowarm.world.config import EnvConfig
from knowarm.world.scene import load_scene

OnLaunch = Callable[[Any, int], None]
"""Called with the kernel and the threads per block of each launch."""

CUDA_BLOCK = 256
"""Threads per block of a launch on CUDA that names no number."""


@contextmanager
def noted_launches(on_launch: OnLaunch) -> Iterator[None]:
    """Call a function instead of launching; MuJoCo Warp takes the branches of a GPU."""
    warp, _ = import_warp()
    find_device = warp.get_device

    def launch(kernel: Any, dim: Any, inputs: Any = (), outputs: Any = (), **options: Any) -> None:
        if kernel.is_generic:
            kernel = warp.overload(kernel, kernel.infer_argument_types([*inputs, *outputs]))
        block = options.get("block_dim") or CUDA_BLOCK
        sizes = dim if isinstance(dim, Iterable) else (dim,)
        if all(size > 0 for size in sizes):  # Warp loads nothing for an empty launch
            on_launch(kernel, block)

    def suggest(kernel: Any, device: Any = None) -> tuple[int, int]:
        on_launch(kernel, CUDA_BLOCK)
        return CUDA_BLOCK, 1

    def device(*arguments: Any) -> Any:
        # Without an argument, MuJoCo Warp asks where it runs.
        gpu = SimpleNamespace(is_cuda=True, is_cpu=False, sm_count=1)
        return find_device(*arguments) if arguments else gpu

    def loop(condition: Any, while_body: Any, stream: Any = None, **arguments: Any) -> None:
        while_body(**arguments)

    with (
        patch.object(warp, "launch", launch),
        patch.object(warp, "launch_tiled", launch),
        patch.object(warp, "get_suggested_block_size", suggest),
        patch.object(warp, "get_device", device),
        patch.object(warp, "capture_while", loop),
    ):
        yield


def simulate(robot: str, dynamics: Dynamics, on_launch: OnLaunch) -> None:
    """Build the simulation of a robot and report the launches of a step and of a reset."""
    scene = load_scene(robot, EnvConfig(robot=robot).targets)
    with noted_launches(on_launch):
        WarpSimulator(scene, 2, torch.device("cpu"), dynamics)


def compile_modules(
    arch: int, robots: Iterable[str], dynamics: Iterable[Dynamics] = ("dynamic", "kinematic")
) -> list[Path]:
    """Compile the modules of robots into Warp's cache; those already there are kept.

    Args:
        arch: compute capability times ten, 90 for an H200.
        robots: names of robots.
        dynamics: how joints follow their targets.

    Returns:
        The machine code of each module and number of threads per block.
    """
    warp, _ = import_warp()
    compiled: dict[str, Path] = {}

    def compile_module(kernel: Any, block: int) -> None:
        # Now, as Warp would: a module's name changes when a kernel is added to it later.
        module = kernel.module
        name = module.get_module_identifier(block)
        if name in compiled:
            return
        usual, module.options["block_dim"] = module.options["block_dim"], block
        try:
            start = time.perf_counter()
            (path,) = warp.compile_aot_module(module, arch=arch, use_ptx=False)
        finally:
            module.options["block_dim"] = usual
        assert path.name.startswith(f"{name}.sm{arch}"), (path, name)
        compiled[name] = path
        print(f"{time.perf_counter() - start:5.1f} s  {name}", flush=True)

    for robot in robots:
        for choice in dynamics:
            simulate(robot, choice, compile_module)
    return list(compiled.values())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cache", type=Path, help="folder for the modules")
    parser.add_argument("--arch", type=int, default=90, help="compute capability times ten")
    parser.add_argument("--robots", nargs="+", default=["irb120"], help="robots to simulate")
    options = parser.parse_args()
    if "warp" in sys.modules:
        sys.exit("Warp was imported before its cache could be chosen.")
    os.environ["WARP_CACHE_PATH"] = str(options.cache.resolve())
    paths = compile_modules(options.arch, options.robots)
    size = sum(path.stat().st_size for path in paths)
    print(f"{len(paths)} modules for sm_{options.arch}, {size / 1e6:.1f} MB, in {options.cache}")


if __name__ == "__main__":
    main()
