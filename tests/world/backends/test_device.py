"""Checks of devices, packages and memory."""

from types import SimpleNamespace
from typing import Any

import numba.cuda
import pytest
import torch

from knowarm.errors import UserError
from knowarm.world.backends import device as devices
from knowarm.world.backends.device import check_memory, choose_backend, memory_needed
from knowarm.world.config import EnvConfig
from knowarm.world.scene import load_scene


def without(package: str) -> Any:
    """A ``find_spec`` that does not find one package."""
    return lambda name: None if name == package else object()


@pytest.fixture
def gpu_of_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pretend that torch has a GPU."""
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)


@pytest.mark.parametrize("package", ["mujoco_warp", "warp"])
def test_a_missing_package_is_named(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "find_spec", without(package))
    with pytest.raises(
        UserError, match=rf"{package}, which is not installed: pip install 'knowarm\[gpu"
    ):
        choose_backend("cuda", None)


@pytest.mark.parametrize("name", ["gpu", "cuda:1", "mps", ""])
def test_other_devices_are_refused(name: str) -> None:
    with pytest.raises(UserError, match=r"'cuda' or 'cpu', got .*CUDA_VISIBLE_DEVICES"):
        choose_backend(name, None)


@pytest.mark.parametrize(
    ("device", "simulator", "expected"),
    [
        ("cpu", None, "mujoco"),
        ("cpu", "mujoco", "mujoco"),
        ("cpu", "warp", "warp"),
    ],
)
def test_the_cpu_has_both_simulators(device: str, simulator: str | None, expected: str) -> None:
    assert choose_backend(device, simulator) == (torch.device("cpu"), expected)


def test_mujoco_needs_no_other_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "find_spec", without("mujoco_warp"))
    assert choose_backend("cpu", None)[1] == "mujoco"
    with pytest.raises(UserError, match="mujoco_warp"):
        choose_backend("cpu", "warp")


def test_wrong_simulators_are_refused() -> None:
    with pytest.raises(UserError, match="simulator 'mujoco' runs on the CPU, got device 'cuda'"):
        choose_backend("cuda", "mujoco")
    with pytest.raises(UserError, match="must be 'mujoco', 'warp' or None, got 'bullet'"):
        choose_backend("cpu", "bullet")


def test_a_torch_without_cuda_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.version, "cuda", None)
    with pytest.raises(UserError, match="is built without"):
        choose_backend("cuda", None)


def test_a_machine_without_a_gpu_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(UserError, match=r"finds no GPU.*nvidia-smi"):
        choose_backend("cuda", None)


def test_a_driver_too_old_for_warp_is_named(
    gpu_of_torch: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    warp = SimpleNamespace(
        __version__="1.19.0",
        is_cuda_available=lambda: False,
        get_cuda_toolkit_version=lambda: (13, 4),
    )
    monkeypatch.setattr(devices, "import_warp", lambda: (warp, None))
    with pytest.raises(UserError, match=r"older than Warp's CUDA 13\.4: install a newer driver"):
        choose_backend("cuda", None)


@pytest.mark.parametrize("fails", [False, True])
def test_a_numba_that_finds_no_gpu_is_named(
    fails: bool, gpu_of_torch: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def is_available() -> bool:
        if fails:
            raise OSError("libcuda is broken")
        return False

    warp = SimpleNamespace(is_cuda_available=lambda: True)
    monkeypatch.setattr(devices, "import_warp", lambda: (warp, None))
    monkeypatch.setattr(numba.cuda, "is_available", is_available)
    with pytest.raises(UserError, match=r"Numba cannot use the GPU.*numba-cuda\[cu13\]") as raised:
        choose_backend("cuda", None)
    assert ("libcuda is broken" in str(raised.value)) == fails


@pytest.mark.parametrize("robot", ["irb120", "tiago"])
def test_memory_grows_with_environments_and_images(robot: str) -> None:
    config = EnvConfig(robot=robot)
    scene = load_scene(robot, tuple(config.targets))
    one, many = memory_needed(scene, config, 1), memory_needed(scene, config, 1001)
    each = (many - one) / 1000
    assert 3 * 3 * 64**2 < each < 500_000
    large = memory_needed(scene, EnvConfig(robot=robot, image_size=128), 1001)
    masks = 8 * 2 * 64 * (1 + scene.model.ngeom // 64)
    assert large - many == 1001 * (3 * 3 * (128**2 - 64**2) + masks)


def test_too_many_environments_for_the_memory_are_refused() -> None:
    config = EnvConfig()
    scene = load_scene("irb120", tuple(config.targets))
    free = 8 * 2**30
    with pytest.raises(UserError, match=r"1000000 environments of 64 x 64 .* 8\.0 GiB") as raised:
        check_memory(scene, config, 1_000_000, free)
    fit = int(str(raised.value).split("up to ")[1].split()[0])
    assert 10_000 < fit < 1_000_000
    check_memory(scene, config, fit, free)
    with pytest.raises(UserError, match=f"up to {fit} fit"):
        check_memory(scene, config, int(1.01 * fit), free)
    with pytest.raises(UserError, match="up to 0 fit"):
        check_memory(scene, config, 1, 1000)
