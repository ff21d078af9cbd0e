"""Tests of ``benchmarks/gpu_pack.py``."""

import hashlib
import struct
import tarfile
from pathlib import Path

import pytest

from benchmarks.gpu_pack import (
    ENTRY,
    ENTRY_ARCH,
    FATBIN,
    MACHINE_CODE,
    MAGIC,
    MOST_BYTES,
    PTX,
    clear_other_gpus,
    download,
    remove_unused,
    split,
    write_archive,
)

OTHER_KIND = 8


def container(*entries: tuple[int, int, bytes]) -> bytes:
    """Return a container of (kind, compute capability, code)."""
    content = b""
    for kind, arch, code in entries:
        header = bytearray(64)
        struct.pack_into(ENTRY, header, 0, kind, 257, len(header), len(code))
        struct.pack_into("<i", header, ENTRY_ARCH, arch)
        content += bytes(header) + code
    return struct.pack(FATBIN, MAGIC, 1, struct.calcsize(FATBIN), len(content)) + content


def test_only_code_for_other_gpus_is_cleared() -> None:
    ours = (MACHINE_CODE, 90, b"ours")
    entries = [(MACHINE_CODE, 80, b"older"), ours, (PTX, 90, b"text"), (OTHER_KIND, 80, b"kept")]
    cleared = [(MACHINE_CODE, 80, bytes(5)), ours, (PTX, 90, bytes(4)), (OTHER_KIND, 80, b"kept")]
    elsewhere = container((MACHINE_CODE, 80, b"alone"))
    noise = struct.pack("<I", MAGIC) + b"not a container, but it begins like one"
    library = bytearray(noise + container(*entries) + b"between" + elsewhere + noise)
    assert clear_other_gpus(library, 90) == 9
    assert bytes(library) == noise + container(*cleared) + b"between" + elsewhere + noise


def test_what_a_gpu_does_not_need_is_removed(tmp_path: Path) -> None:
    unused = ["bin/tool", "warp/tests/a.py", "warp/bin/warp-clang.so", "mujoco_warp/_src/a_test.py"]
    used = ["warp/bin/warp.so", "mujoco_warp/_src/a.py", "nvidia/cu13/lib/libnvvm.so.4"]
    for name in unused + used:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(container((MACHINE_CODE, 90, b"x")))
    remove_unused(tmp_path, 90)
    found = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert found == set(used)


def test_exactly_the_listed_packages_are_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    commands: list[list[str]] = []
    monkeypatch.setattr(
        "benchmarks.gpu_pack.subprocess.run", lambda command, check: commands.append(command)
    )
    download(Path("site"), Path("requirements.txt"))
    (command,) = commands
    assert command[1:4] == ["-m", "pip", "install"]
    assert {"--no-deps", "--no-compile", "--only-binary=:all:"} <= set(command)
    assert "--python-version=3.12" in command
    assert command[command.index("--target") + 1] == "site"
    assert command[-2:] == ["--requirement", "requirements.txt"]


@pytest.mark.parametrize(("size", "count"), [(1, 1), (100, 1), (101, 2), (250, 3)])
def test_parts_are_equal_and_small_enough(size: int, count: int, tmp_path: Path) -> None:
    archive = tmp_path / "site.tar.xz"
    archive.write_bytes(bytes(range(256))[:size])
    parts = split(archive, tmp_path / "pack", 100)
    assert len(parts) == count
    assert b"".join(part.read_bytes() for part in parts) == archive.read_bytes()
    assert max(part.stat().st_size for part in parts) <= 100 <= MOST_BYTES
    digest = hashlib.sha256(archive.read_bytes()).hexdigest()
    for part in parts:
        assert part.with_name("site.tar.xz.sha256").read_text() == f"{digest}\n"


def test_an_archive_holds_the_folders_under_their_names(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder / "deep").mkdir(parents=True)
        (tmp_path / folder / "deep" / "file").write_text(folder)
    write_archive(tmp_path / "x.tar.xz", site=tmp_path / "a", cache=tmp_path / "b")
    with tarfile.open(tmp_path / "x.tar.xz") as tar:
        assert tar.getnames() == ["site/deep/file", "cache/deep/file"]
