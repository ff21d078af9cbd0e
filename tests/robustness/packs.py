"""Packs of studies for the campaign of mutations: compressed, and the archive inside."""

import hashlib
import io
import json
import lzma
import shutil
import tarfile
from collections.abc import Callable
from pathlib import Path

from knowarm.study.pack import unpack_study


def pack_readers(folder: Path) -> list[tuple[str, Path, Callable[[Path], None]]]:
    """Write a small pack, and its archive without compression, whose mutations reach the reader."""
    folder.mkdir()
    texts = {"study.json": b"{}", "a/0/config.json": b"{}" * 300}
    manifest = {
        "sha256": {
            name: hashlib.sha256(text).hexdigest() for name, text in texts.items()
        }
    }
    pack, archive = folder / "pack.tar.xz", folder / "pack.tar"
    with tarfile.open(archive, "w", format=tarfile.USTAR_FORMAT) as file:
        for name, text in {
            "manifest.json": json.dumps(manifest).encode(),
            **texts,
        }.items():
            member = tarfile.TarInfo(name)
            member.size = len(text)
            file.addfile(member, io.BytesIO(text))
    pack.write_bytes(lzma.compress(archive.read_bytes()))

    def unpack(path: Path) -> None:
        out = folder / "out"
        try:
            unpack_study(path, out)
        finally:
            shutil.rmtree(out, ignore_errors=True)
            assert {each.name for each in folder.iterdir()} <= {
                "pack.tar",
                "pack.tar.xz",
                "x",
            }

    def compressed(path: Path) -> None:
        """Sum up the mutated headers, so that they are read, and compress the archive."""
        data = bytearray(path.read_bytes())
        for start in range(0, len(data) - 511, 512):
            if data[start + 257 : start + 262] == b"ustar":
                data[start + 148 : start + 156] = b" " * 8
                data[start + 148 : start + 156] = b"%06o\0 " % sum(
                    data[start : start + 512]
                )
        (folder / "x").write_bytes(lzma.compress(bytes(data)))
        unpack(folder / "x")

    return [("pack", pack, unpack), ("archive of a pack", archive, compressed)]
