"""Warp's modules are compiled for a GPU that is not there."""

from typing import Any

import pytest
import torch

from benchmarks.gpu_warp_cache import CUDA_BLOCK, compile_modules, noted_launches, simulate
from knowarm.world.backends.warp import WarpSimulator, import_warp
from knowarm.world.config import EnvConfig
from knowarm.world.scene import load_scene

pytest.importorskip("mujoco_warp")

CUDA_MACHINE = 190
"""Value of e_machine in the header of an ELF file with code for an NVIDIA GPU."""


def test_the_noted_launches_are_those_of_a_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    noted: set[str] = set()
    simulate("irb120", "dynamic", lambda kernel, block: noted.add(kernel.key))
    warp, _ = import_warp()
    executed: set[str] = set()

    def note(launch: Any) -> Any:
        def call(kernel: Any, *arguments: Any, **options: Any) -> None:
            dim = arguments[0] if arguments else options["dim"]
            if min(dim if isinstance(dim, tuple | list) else (dim,)) > 0:
                executed.add(kernel.key)
            launch(kernel, *arguments, **options)

        return call

    for name in ("launch", "launch_tiled"):
        monkeypatch.setattr(warp, name, note(getattr(warp, name)))
    scene = load_scene("irb120", EnvConfig().targets)
    WarpSimulator(scene, 2, torch.device("cpu"), "dynamic")
    assert len(executed) > 30
    assert noted == executed


def test_blocks_are_those_of_cuda() -> None:
    """On the CPU every block has one thread."""
    warp, _ = import_warp()
    seen: list[int] = []

    @warp.kernel
    def nothing(values: warp.array(dtype=float)):  # type: ignore[valid-type]
        pass

    values = warp.zeros(4, dtype=float, device="cpu")
    with noted_launches(lambda kernel, block: seen.append(block)):
        warp.launch(nothing, dim=4, inputs=[values])
        warp.launch(nothing, dim=0, inputs=[values])
        warp.launch_tiled(nothing, dim=(2, 2), inputs=[values], block_dim=64)
    assert seen == [CUDA_BLOCK, 64]


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["irb120", "tiago"])
def test_modules_are_compiled_for_compute_capability_9(robot: str) -> None:
    """Into Warp's own cache, so that only the first call takes minutes."""
    paths = compile_modules(90, [robot])
    assert len(paths) > 20
    for path in paths:
        code = path.read_bytes()
        assert path.name.endswith(".sm90.cubin")
        assert code[:4] == b"\x7fELF"
        assert int.from_bytes(code[18:20], "little") == CUDA_MACHINE
        assert path.with_name(path.name.replace(".sm90.cubin", ".meta")).is_file()
