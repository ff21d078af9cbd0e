"""Every defect of a stored file is one kind of error, on one line."""

import errno
import json
import os

import numpy as np
import pytest
from safetensors.numpy import save_file

from knowarm.errors import UserError
from knowarm.reading import (
    UnreadableFileError,
    read_arrays,
    read_json,
    reading,
    refuse_links,
    write_json,
)


class PanicException(BaseException):
    """What libraries written in Rust raise."""


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (
            KeyError("table"),
            r"f\.bin is damaged or of another format: missing 'table'\. Fix it\.",
        ),
        (ValueError("two\nlines"), "two lines"),
        (MemoryError(), "MemoryError"),
        (RecursionError("deep"), "deep"),
        (PanicException("index out of bounds"), "index out of bounds"),
        (
            PermissionError(13, "Permission denied"),
            r"Cannot read .*f\.bin: Permission denied\.",
        ),
    ],
)
def test_whatever_reading_raises_names_file_and_remedy(tmp_path, error, message):
    with (
        pytest.raises(UnreadableFileError, match=message) as caught,
        reading(tmp_path / "f.bin", "Fix it."),
    ):
        raise error
    assert "\n" not in str(caught.value)


def test_errors_for_users_and_interrupts_pass(tmp_path):
    with pytest.raises(UserError, match="mine"), reading(tmp_path, ""):
        raise UserError("mine")
    with pytest.raises(KeyboardInterrupt), reading(tmp_path, ""):
        raise KeyboardInterrupt


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"[1]",
        b"3",
        b"\xff{}",
        b'{"a":' * 200_000,
        b"[" * 200_000,
        b'{"a": 1}x',
    ],
)
def test_damaged_json(tmp_path, content):
    path = tmp_path / "f.json"
    path.write_bytes(content)
    with pytest.raises(UnreadableFileError, match=r"f\.json"):
        read_json(path)
    path.write_text(json.dumps({"ä": 1}), encoding="utf-8")
    assert read_json(path) == {"ä": 1}


def test_damaged_arrays(tmp_path):
    path = tmp_path / "f.safetensors"
    save_file({"a": np.arange(3)}, path)
    np.testing.assert_array_equal(read_arrays(path, remedy="")["a"], np.arange(3))
    for content in (b"", b"\xff" * 8, path.read_bytes()[:-3], b"\x01" * 40):
        path.write_bytes(content)
        with pytest.raises(UnreadableFileError, match="Train again"):
            read_arrays(path, remedy="Train again.")


def test_a_file_is_replaced_without_following_links(tmp_path):
    """A link at the target, or at any name that could be predicted, leads to the user's file."""
    precious = tmp_path / "precious"
    precious.write_text("mine")
    folder = tmp_path / "cloned"
    folder.mkdir()
    for name in ("summary.json", ".summary.tmp.json"):
        (folder / name).symlink_to(precious)
    write_json(folder / "summary.json", {"a": 1})
    assert precious.read_text() == "mine"
    assert read_json(folder / "summary.json") == {"a": 1}
    assert sorted(path.name for path in folder.iterdir()) == [
        ".summary.tmp.json",
        "summary.json",
    ]


def test_no_prepared_link_is_written_through(tmp_path, monkeypatch):
    monkeypatch.setattr("secrets.token_hex", lambda count: "guessed")
    (tmp_path / ".a.guessed.json").symlink_to(tmp_path / "new")
    with pytest.raises(UserError, match=r"Cannot write .*File exists"):
        write_json(tmp_path / "a.json", {})
    assert not (tmp_path / "new").exists()


def test_links_out_of_a_folder_are_refused(tmp_path):
    repository = tmp_path / "models--someone--reach"
    folder = repository / "snapshots" / "1f"
    (folder / "evaluation").mkdir(parents=True)
    (repository / "blobs").mkdir()
    (folder / "a").symlink_to("b")
    (folder / "evaluation" / "up").symlink_to("..")
    (folder / "weights").symlink_to("../../blobs/1f")  # as the Hub's cache keeps files
    refuse_links(folder)
    for target in (
        "../../../secret",
        "../../blobs/../secret",
        "/dev/zero",
        "../../blobs/a/b",
        "/",
    ):
        link = folder / "evaluation" / "link"
        link.symlink_to(target)
        with pytest.raises(
            UserError, match=r"link is a link to .*Replace it by a copy"
        ):
            refuse_links(folder)
        link.unlink()
    other = repository.rename(tmp_path / "home")  # where blobs may be the user's
    with pytest.raises(UserError, match="weights is a link to "):
        refuse_links(other / "snapshots" / "1f")


def test_a_folder_that_cannot_be_listed_may_hold_links(tmp_path, monkeypatch):
    """Files in one without the permission to read are opened by their names all the same."""
    (tmp_path / "evaluation").mkdir()
    scandir = os.scandir

    def unlisted(path):
        if "evaluation" in str(path):
            raise PermissionError(errno.EACCES, "Permission denied", path)
        return scandir(path)

    monkeypatch.setattr("os.scandir", unlisted)
    with pytest.raises(UserError, match=r"Cannot read .*evaluation: Permission denied"):
        refuse_links(tmp_path)
