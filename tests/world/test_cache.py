"""The cache of arrays: a damaged file is computed again, and no folder is guessed."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from knowarm.world.cache import cache_file, read_arrays, write_arrays


@pytest.fixture
def file(tmp_path):
    write_arrays(tmp_path / "made" / "a.npz", {"a": np.arange(3)})
    return tmp_path / "made" / "a.npz"


def test_what_is_written_is_read(file):
    np.testing.assert_array_equal(read_arrays(file)["a"], np.arange(3))
    assert [*file.parent.iterdir()] == [file]


@pytest.mark.parametrize("damage", ["method", "encrypted", "npy", "cut", "empty"])
def test_a_damaged_file_is_none(file, damage):
    data = bytearray(file.read_bytes())
    central = data.index(b"PK\1\2")
    if damage == "method":
        data[8] = data[central + 10] = 99
    elif damage == "encrypted":
        data[6] |= 1
        data[central + 8] |= 1
    elif damage == "npy":
        stream = io.BytesIO()
        np.save(stream, np.arange(3))
        data = stream.getvalue()
    file.write_bytes({"cut": data[:-9], "empty": b""}.get(damage, data))
    if damage not in ("cut", "empty", "npy"):
        assert zipfile.is_zipfile(file)
    assert read_arrays(file) is None


def test_a_relative_folder_of_the_cache_is_ignored(monkeypatch, tmp_path):
    """A stranger's folder could hold it, if one works there."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("KNOWARM_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", "cache")
    assert cache_file("kind", 1).is_relative_to(Path.home() / ".cache")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_file("kind", 1).is_relative_to(tmp_path)
