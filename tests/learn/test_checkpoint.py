import dataclasses
import errno
import json
import os

import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.learn import checkpoint as module
from knowarm.learn.checkpoint import Checkpoint, CheckpointStore, read_checkpoint

WHAT = {"robot": "irb120", "agent": "full", "hidden": 278}


def made(step):
    return Checkpoint(
        policy={"weight": np.full((3, 2), step, np.float32)},
        optimizer={"weight/step": np.array(7.0, np.float32)},
        state={
            "counter": np.array([2**63 + 1], np.uint64),
            "flag": np.array([True, False]),
        },
        facts={"step": step},
    )


@pytest.fixture
def store(tmp_path):
    return CheckpointStore(tmp_path / "checkpoints", WHAT)


def test_what_was_saved_is_read_back_to_the_byte(store):
    store.save(made(5))
    read = store.load()
    assert read.facts == {"step": 5}
    for part in ("policy", "optimizer", "state"):
        for name, array in getattr(made(5), part).items():
            got = getattr(read, part)[name]
            assert (got.dtype, got.shape) == (array.dtype, array.shape)
            assert got.tobytes() == array.tobytes()


def test_transposed_arrays_are_saved_as_they_look(store):
    array = np.arange(6.0).reshape(2, 3).T
    store.save(Checkpoint(policy={"a": array}, facts={"step": 1}))
    np.testing.assert_array_equal(store.load().policy["a"], array)


def test_the_one_before_is_kept(store):
    for step in (1, 2, 3):
        store.save(made(step))
    assert store.load().facts["step"] == 3
    assert read_checkpoint(store.folder / "previous").facts["step"] == 2
    assert sorted(p.name for p in store.folder.iterdir()) == ["latest", "previous"]


def test_the_best_is_replaced_and_stands_alone(store):
    store.save_best(made(1))
    store.save_best(made(2))
    assert read_checkpoint(store.folder / "best").facts["step"] == 2
    assert [p.name for p in store.folder.iterdir()] == ["best"]


@pytest.mark.parametrize(
    "file", ["policy.safetensors", "state.safetensors", "meta.json"]
)
@pytest.mark.parametrize("harm", ["truncate", "delete", "overwrite"])
def test_a_damaged_latest_falls_back_to_the_previous(store, file, harm, caplog):
    store.save(made(1))
    store.save(made(2))
    path = store.folder / "latest" / file
    if harm == "truncate":
        os.truncate(path, path.stat().st_size // 2)
    elif harm == "delete":
        path.unlink()
    else:
        path.write_bytes(b"\0" * path.stat().st_size)
    assert store.load().facts["step"] == 1
    assert file in caplog.text
    with pytest.raises(UserError, match=file):
        read_checkpoint(store.folder / "latest")


def test_a_kill_between_the_renames_leaves_the_previous(store):
    store.save(made(1))
    (store.folder / "latest").rename(store.folder / "previous")
    (store.folder / ".latest-being-written").mkdir()
    assert store.load().facts["step"] == 1
    store.save(made(2))
    assert store.load().facts["step"] == 2


@pytest.mark.parametrize("save", ["save", "save_best"])
def test_a_rename_that_fails_leaves_the_one_before(store, monkeypatch, save):
    getattr(store, save)(made(1))
    name = "latest" if save == "save" else "best"
    rename = module.Path.rename

    def fail(path, target):
        if path.name.endswith("-being-written"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return rename(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(module.Path, "rename", fail)
        for step in (2, 3):
            with pytest.raises(UserError, match=f"step {step} .*intact"):
                getattr(store, save)(made(step))
            assert read_checkpoint(store.folder / name).facts["step"] == 1
    getattr(store, save)(made(4))
    assert read_checkpoint(store.folder / name).facts["step"] == 4
    assert not [path for path in store.folder.iterdir() if path.name.startswith(".")]


def test_a_kill_between_the_renames_leaves_the_best_before(store, monkeypatch):
    store.save_best(made(1))
    rename = module.Path.rename

    def killed(path, target):
        if path.name == ".best-being-written":
            raise KeyboardInterrupt
        return rename(path, target)

    monkeypatch.setattr(module.Path, "rename", killed)
    with pytest.raises(KeyboardInterrupt):
        store.save_best(made(2))
    monkeypatch.undo()
    assert not (store.folder / "best").exists()
    assert read_checkpoint(store.folder / "best").facts == {"step": 1}
    store.save_best(made(3))
    assert read_checkpoint(store.folder / "best").facts == {"step": 3}


def test_a_foreign_checkpoint_is_refused_with_both_descriptions(store):
    store.save(made(1))
    other = CheckpointStore(store.folder, {**WHAT, "robot": "tiago", "hidden": 128})
    with pytest.raises(UserError) as caught:
        other.load()
    message = str(caught.value)
    assert "robot: 'irb120' | 'tiago'" in message
    assert "hidden: 278 | 128" in message
    assert "agent" not in message
    assert "\n" not in message


def test_no_checkpoint_at_all_is_said(store):
    with pytest.raises(UserError, match="no checkpoint"):
        store.load()
    with pytest.raises(UserError, match="no checkpoint"):
        read_checkpoint(store.folder / "best")


def test_a_full_disk_is_said_and_leaves_the_checkpoint_before(store, monkeypatch):
    store.save(made(1))
    written = []

    def full(path, data):
        if len(written) == 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        written.append(path)
        path.write_bytes(data)

    monkeypatch.setattr(module, "_write_file", full)
    with pytest.raises(UserError, match=r"step 2 .*No space left on device.*intact"):
        store.save(made(2))
    assert len(written) == 2
    assert store.load().facts["step"] == 1
    assert [p.name for p in store.folder.iterdir()] == ["latest"]


def test_facts_are_plain_json(store):
    store.save(dataclasses.replace(made(1), facts={"step": 1, "best_return": None}))
    meta = json.loads((store.folder / "latest/meta.json").read_text())
    assert meta["format"] == 1
    assert meta["description"] == WHAT
    assert set(meta["sha256"]) == {"policy", "optimizer", "state"}
