"""Pack what benchmarks/gpu.sh needs for a machine with a GPU and without network.

    python benchmarks/gpu_pack.py PACK [--warp-cache CACHE]

Downloads the packages of gpu-requirements.txt for Linux and Python 3.12, leaves out what is not
used there, and writes one archive in parts: PACK/1/site.tar.xz.1of2 and PACK/2/site.tar.xz.2of2.
Each folder is one transfer, and also holds the SHA-256 digest of the whole archive.
"""

import argparse
import hashlib
import lzma
import shutil
import struct
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent

MOST_BYTES = 48_000_000
"""Size of the largest file."""

TRANSFER_BYTES = 64 * 2**20
"""Size of a transfer, the checkout included."""

PLATFORMS = ("2_28", "2_27", "2_17", "2_12")
"""Versions of manylinux whose wheels are taken."""

UNUSED = (
    "bin",
    "mujoco/doc",
    "mujoco/include",
    "mujoco_warp/test_data",
    "nvidia/cu13/include",
    "nvidia/cu13/nvvm/bin",  # nvcc's compiler; Numba needs the library
    "warp/bin/warp-clang.so",  # compiles for CPUs only
    "warp/examples",
    "warp/tests",
)
"""Files and folders that are left out."""

FILTERS = [
    {"id": lzma.FILTER_X86},
    {"id": lzma.FILTER_LZMA2, "preset": 9 | lzma.PRESET_EXTREME, "dict_size": 2**29},
]
"""The dictionary spans the archive: Warp's library contains the same compiler several times, about
100 MB apart. Unpacking takes as much memory, packing about ten times as much."""

FATBIN, MAGIC = "<IHHQ", 0xBA55ED50
"""Header of a container of code for several GPUs: magic number, version, sizes of header and
content."""

ENTRY, ENTRY_ARCH = "<HHIQ", 28
"""Header of its entries: kind, version, sizes of header and content. The compute capability times
ten is an int32 at this offset."""

PTX, MACHINE_CODE = 1, 2
"""Kinds of entries."""


def clear_other_gpus(library: bytearray, arch: int) -> int:
    """Overwrite a library's code for other GPUs with zeros, which compress to nothing.

    Headers and sizes stay, and a driver reads only the entry of its own GPU.

    Args:
        library: shared library with CUDA code; changed in place.
        arch: compute capability times ten of the GPU whose machine code is kept. A container
            without it is left as it is.

    Returns:
        Number of bytes that were cleared.
    """
    cleared = 0
    for entries in _containers(library):
        if not any(kind == MACHINE_CODE and code == arch for kind, code, *_ in entries):
            continue
        for kind, code, start, size in entries:
            if kind in (PTX, MACHINE_CODE) and (kind, code) != (MACHINE_CODE, arch):
                library[start : start + size] = bytes(size)
                cleared += size
    return cleared


def _containers(library: bytearray) -> Iterator[list[tuple[int, int, int, int]]]:
    """Yield kind, architecture, start and size of the entries of each container."""
    magic, at = struct.pack("<I", MAGIC), 0
    while (at := library.find(magic, at)) >= 0:
        _, version, header, content = struct.unpack_from(FATBIN, library, at)
        entry, end = at + header, at + header + content
        at += 4
        if version != 1 or header != struct.calcsize(FATBIN) or end > len(library):
            continue  # four bytes that look like the number
        entries = []
        while entry < end:
            kind, _, head, size = struct.unpack_from(ENTRY, library, entry)
            (arch,) = struct.unpack_from("<i", library, entry + ENTRY_ARCH)
            entries.append((kind, arch, entry + head, size))
            entry += head + size
        if entry == end:
            yield entries


def download(site: Path, requirements: Path) -> None:
    """Install the required packages, and no others, into a folder for Linux and Python 3.12."""
    platforms = [f"--platform=manylinux_{version}_x86_64" for version in PLATFORMS]
    target = ["--target", str(site), "--python-version=3.12", "--implementation=cp", *platforms]
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    options = ["--no-deps", "--no-compile", "--only-binary=:all:", "--requirement"]
    subprocess.run([*command, *target, *options, str(requirements)], check=True)


def remove_unused(site: Path, arch: int) -> None:
    """Remove what no GPU of an architecture needs."""
    for name in UNUSED:
        path = site / name
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    for path in site.glob("mujoco_warp/_src/*_test.py"):
        path.unlink()
    for path in site.glob("warp/bin/warp.so"):
        library = bytearray(path.read_bytes())
        cleared = clear_other_gpus(library, arch)
        print(f"{path.name}: {cleared / 1e6:.1f} MB of code for other GPUs cleared", flush=True)
        path.write_bytes(library)


def write_archive(archive: Path, **folders: Path) -> None:
    """Write folders, under the names of the arguments, into one compressed archive."""

    def plain(member: tarfile.TarInfo) -> tarfile.TarInfo:
        member.uid = member.gid = member.mtime = 0
        member.uname = member.gname = ""
        return member

    with (
        lzma.open(archive, "wb", format=lzma.FORMAT_XZ, filters=FILTERS) as file,
        tarfile.open(fileobj=file, mode="w") as tar,
    ):
        for name, folder in folders.items():
            for path in sorted(path for path in folder.rglob("*") if path.is_file()):
                tar.add(path, f"{name}/{path.relative_to(folder)}", filter=plain)


def split(archive: Path, pack: Path, most_bytes: int) -> list[Path]:
    """Split an archive into equal parts, in a folder each, with the digest of the archive."""
    size = archive.stat().st_size
    count = -(-size // most_bytes)
    length = -(-size // count)
    parts = []
    with archive.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        file.seek(0)
        for number in range(1, count + 1):
            part = pack / str(number) / f"{archive.name}.{number}of{count}"
            part.parent.mkdir(parents=True)
            part.write_bytes(file.read(length))
            part.with_name(f"{archive.name}.sha256").write_text(f"{digest}\n")
            parts.append(part)
    return parts


def checkout_bytes() -> int:
    """Return the size of the files of the checkout that git does not ignore."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    paths = [ROOT / name for name in set(done.stdout.split("\0")) if name]
    return sum(path.stat().st_size for path in paths if path.is_file())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pack", type=Path, help="folder to write; must not exist")
    parser.add_argument("--warp-cache", type=Path, help="folder of gpu_warp_cache.py")
    parser.add_argument("--arch", type=int, default=90, help="compute capability times ten")
    options = parser.parse_args()
    if options.pack.exists():
        sys.exit(f"{options.pack} exists; choose another folder, or remove it.")
    with tempfile.TemporaryDirectory() as temporary:
        folders = {"site": Path(temporary) / "site"}
        download(folders["site"], ROOT / "benchmarks" / "gpu-requirements.txt")
        remove_unused(folders["site"], options.arch)
        if options.warp_cache is not None:
            folders["warp-cache"] = options.warp_cache
        archive = Path(temporary) / "site.tar.xz"
        write_archive(archive, **folders)
        parts = split(archive, options.pack, MOST_BYTES)
    checkout = checkout_bytes()
    for part in parts:
        size = part.stat().st_size
        print(f"{size / 1e6:6.1f} MB  {part}, with the checkout {(size + checkout) / 1e6:.1f} MB")
    if any(part.stat().st_size + checkout > TRANSFER_BYTES for part in parts):
        sys.exit(f"A transfer is larger than {TRANSFER_BYTES / 1e6:.1f} MB.")


if __name__ == "__main__":
    main()
