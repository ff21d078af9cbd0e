import hashlib
import io
import json
import lzma
import shutil
import tarfile

import pytest

from knowarm.errors import UserError
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.run_lock import lock_folder
from knowarm.report import write_report
from knowarm.study.config import STUDY_FILE
from knowarm.study.driver import open_study, run_study
from knowarm.study.pack import SUFFIX, pack_study, unpack_study
from knowarm.study.status import study_status

pytestmark = pytest.mark.usefixtures("inline")


@pytest.fixture
def pack(finished, tmp_path):
    file = tmp_path / "study.tar.xz"
    pack_study(finished, file)
    return file


def test_the_report_of_a_pack_equals_that_of_the_study(finished, tmp_path, pack):
    copy = shutil.copytree(finished, tmp_path / "copy")
    pack_study(copy, tmp_path / "copy.tar.xz")
    assert (tmp_path / "copy.tar.xz").read_bytes() == pack.read_bytes()
    out = unpack_study(pack, tmp_path / "unpacked")
    pages = [write_report([folder], folder / "report.html") for folder in (copy, out)]
    assert pages[0].read_bytes() == pages[1].read_bytes()
    assert [each.state for each in study_status(open_study(out), out)] == [
        "done",
        "done",
    ]
    run = out / "irb120-bm-ppo" / "0"
    assert evaluate(run, episodes=2, probes=()).summary["episodes"] == 2
    assert not (run / "checkpoints" / "latest" / "optimizer.safetensors").exists()
    assert not (run / "tensorboard").exists()


def test_parts_can_be_left_out(finished, tmp_path, pack):
    small = tmp_path / "small.tar.xz"
    pack_study(finished, small, leave_out=("policies", "episodes", "steps", "films"))
    assert small.stat().st_size < pack.stat().st_size / 2
    out = unpack_study(small, tmp_path / "small")
    assert [each.state for each in study_status(open_study(out), out)] == [
        "done",
        "done",
    ]
    assert write_report([out], out / "report.html").exists()
    with pytest.raises(UserError, match=r"'film'.*'films'"):
        pack_study(finished, small, leave_out=("film",))


def test_the_report_needs_no_losses(finished, tmp_path, pack):
    short = tmp_path / "short.tar.xz"
    pack_study(finished, short, leave_out=("losses",))
    name = "irb120-bm-ppo/0/metrics.csv"
    whole, reported = (
        unpack_study(file, tmp_path / file.name.removesuffix(SUFFIX))
        for file in (pack, short)
    )
    assert "value_loss" in (whole / name).read_text().splitlines()[0]
    lines = (reported / name).read_text().splitlines()
    assert lines[0] == "step,wall_time_s,steps_per_s"  # too short for a return
    assert len(lines) == len((whole / name).read_text().splitlines())
    pages = [
        write_report([folder], folder / "report.html") for folder in (whole, reported)
    ]
    assert pages[0].read_bytes() == pages[1].read_bytes()
    with pytest.raises(UserError, match="leave out losses or checkpoints"):
        pack_study(finished, short, leave_out=("losses",), with_checkpoints=True)


def test_a_perception_module_belongs_to_the_policies(finished, tmp_path):
    copy = shutil.copytree(finished, tmp_path / "copy")
    name = "irb120-bm-ppo/0/perception.safetensors"
    (copy / name).write_bytes(b"module")
    for leave_out, kept in (((), True), (("policies",), False)):
        file = tmp_path / f"{kept}.tar.xz"
        pack_study(copy, file, leave_out=leave_out)
        assert (unpack_study(file, tmp_path / str(kept)) / name).exists() == kept


def test_the_missing_runs_of_an_unpacked_study_are_run(finished, tmp_path):
    """A pack of what is done can be completed elsewhere, with the result of the whole study."""
    part = shutil.copytree(finished, tmp_path / "part")
    shutil.rmtree(part / "irb120-bm-ppo" / "1")
    long = part / "irb120-bm-ppo/0/graphs/0a" / f"{'g' * 150}.ttl"
    long.parent.mkdir(parents=True)
    long.write_text("")
    pack_study(part, tmp_path / "part.tar.xz", leave_out=("policies", "steps", "films"))
    out = unpack_study(tmp_path / "part.tar.xz", tmp_path / "unpacked")
    assert (out / long.relative_to(part)).is_file()
    kept = out / "irb120-bm-ppo" / "0" / "metrics.csv"
    before = kept.stat().st_mtime_ns
    assert [each.state for each in run_study(open_study(out), out)] == ["done", "done"]
    assert kept.stat().st_mtime_ns == before
    name = "irb120-bm-ppo/1/evaluations.csv"
    assert (out / name).read_bytes() == (finished / name).read_bytes()


def test_begun_runs_of_an_unpacked_study_are_not_run(finished, tmp_path):
    part = shutil.copytree(finished, tmp_path / "part")
    shutil.rmtree(part / "irb120-bm-ppo" / "1" / "evaluation")
    pack_study(part, tmp_path / "part.tar.xz")
    out = unpack_study(tmp_path / "part.tar.xz", tmp_path / "unpacked")
    with pytest.raises(
        UserError, match=r"unpacked study.*irb120-bm-ppo/1.*remove the folders"
    ):
        run_study(open_study(out), out)
    shutil.rmtree(out / "irb120-bm-ppo" / "1")
    assert [each.state for each in run_study(open_study(out), out)] == ["done", "done"]


def test_begun_runs_go_on_elsewhere_from_a_pack_with_checkpoints(finished, tmp_path):
    begun = tmp_path / "begun"
    run_study(open_study(finished), begun, until_step=20)
    pack_study(begun, tmp_path / "begun.tar.xz", with_checkpoints=True)
    out = unpack_study(tmp_path / "begun.tar.xz", tmp_path / "unpacked")
    assert [each.state for each in study_status(open_study(out), out)] == [
        "stopped",
        "stopped",
    ]
    assert [each.state for each in run_study(open_study(out), out)] == ["done", "done"]
    for name in ("policy", "optimizer", "state"):
        file = f"irb120-bm-ppo/1/checkpoints/latest/{name}.safetensors"
        assert (out / file).read_bytes() == (finished / file).read_bytes()
    pack_study(out, tmp_path / "all.tar.xz", with_checkpoints=True)
    pack_study(out, tmp_path / "none.tar.xz")
    packs = [(tmp_path / f"{name}.tar.xz").read_bytes() for name in ("all", "none")]
    assert packs[0] == packs[1], "finished runs need no checkpoint"


def test_a_damaged_pack_is_refused(finished, tmp_path, pack):
    content = lzma.decompress(pack.read_bytes())
    (tmp_path / "cut.tar.xz").write_bytes(pack.read_bytes()[:5000])
    (tmp_path / "changed.tar.xz").write_bytes(
        lzma.compress(content.replace(b'"name": "tiny"', b'"name": "tinx"'))
    )
    (tmp_path / "text.tar.xz").write_text("no archive")
    for name, words in (
        ("cut", ""),
        ("changed", f"{STUDY_FILE} is missing or was changed"),
        ("text", ""),
    ):
        with pytest.raises(UserError, match=f"(is damaged|Cannot read).*{words}"):
            unpack_study(tmp_path / f"{name}.tar.xz", tmp_path / name)
        assert not (tmp_path / name).exists()
    with pytest.raises(UserError, match="exists"):
        unpack_study(pack, finished)


def write_pack(file, members, **manifest):
    """Write a pack of (member, content) whose manifest fits, except where ``manifest`` differs.

    Its ``text`` stands in place of it.
    """
    values = {
        "format": 1,
        "sha256": {
            member.name: hashlib.sha256(data).hexdigest() for member, data in members
        },
    }
    text = manifest.get("text", json.dumps(values | manifest)).encode()
    with tarfile.open(file, "w:xz") as archive:
        for member, data in [(tarfile.TarInfo("manifest.json"), text), *members]:
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))


def link(name: str, to: str) -> tarfile.TarInfo:
    member = tarfile.TarInfo(name)
    member.type, member.linkname = tarfile.SYMTYPE, to
    return member


@pytest.mark.parametrize(
    ("members", "manifest", "words"),
    [
        ([(tarfile.TarInfo("../outside"), b"x")], {}, "outside"),
        ([(tarfile.TarInfo("/tmp/knowarm-outside"), b"x")], {}, ""),
        ([(link("a", "/etc/passwd"), b"")], {}, "a is not .* or no regular file"),
        ([(tarfile.TarInfo("a"), b"x")], {"sha256": {}}, "not one of the manifest"),
        (
            [(tarfile.TarInfo("a"), b"x"), (tarfile.TarInfo("a"), b"x")],
            {},
            "not one of",
        ),
        (
            [(tarfile.TarInfo("a"), b"x")],
            {"sha256": {"a": "0"}},
            "a is missing or was changed",
        ),
        ([], {"sha256": {"a": "0"}}, "a is missing or was changed"),
        ([], {"sha256": []}, "manifest.json, or an empty one"),
        *(
            ([], {"text": text}, "")
            for text in ("[]", "[" * 100_000, '{"sha256": 3}', "1e999")
        ),
    ],
)
def test_packs_of_strangers_write_only_what_their_manifest_states(
    tmp_path, members, manifest, words
):
    write_pack(tmp_path / "hostile.tar.xz", members, **manifest)
    with pytest.raises(UserError, match=f"is damaged or of another format.*{words}"):
        unpack_study(tmp_path / "hostile.tar.xz", tmp_path / "in" / "out")
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["hostile.tar.xz", "in"]


def test_what_cannot_be_packed_is_refused(finished, tmp_path):
    with pytest.raises(UserError, match="holds no study"):
        pack_study(tmp_path, tmp_path / "x.tar.xz")
    with pytest.raises(UserError, match=r"\.tar\.xz"):
        pack_study(finished, tmp_path / "x.zip")
    with lock_folder(finished, remedy=""), pytest.raises(UserError, match="Stop it"):
        pack_study(finished, tmp_path / "x.tar.xz")
