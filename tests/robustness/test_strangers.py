"""Run folders, studies and reports of strangers: nothing outside of the folder is read or written.

The folders are as `git clone` or unzip leave them: any file, and symbolic links.
"""

import json
import os
import shutil
import signal
import socket
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from knowarm.cli.main import main
from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.experiment.load import load_agent
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run import train
from knowarm.experiment.run_folder import RunFolder
from knowarm.experiment.run_lock import is_locked, lock_folder
from knowarm.knowledge import read_graph
from knowarm.reading import read_json, write_json
from knowarm.report import write_report
from knowarm.study.config import StudyConfig, read_study, write_study
from knowarm.world.description import trust
from knowarm.world.objects import find_targets
from knowarm.world.robots import find_robot
from tests.source_tree import ROOT
from tests.thorough import combinations
from tests.tiny import short

BRIEF = {"episodes": 2, "probes": ()}


@pytest.fixture
def run(tmp_path):
    return shutil.copytree(
        ROOT / "zoo" / "irb120-full-fast", tmp_path / "runs" / "x" / "0"
    )


@pytest.fixture
def precious(tmp_path):
    """A file of the user, which nothing may change."""
    path = tmp_path / "home" / "bashrc"
    path.parent.mkdir()
    path.write_text("export EDITOR=vi\n")
    yield path
    assert path.read_text() == "export EDITOR=vi\n"
    assert [*path.parent.iterdir()] == [path]


def edit(run, *names, **values):
    """Change fields of config.json, those of the nested config ``names``."""
    config = inner = json.loads((run / "config.json").read_text())
    for name in names:
        inner = inner[name]
    inner |= values
    (run / "config.json").write_text(json.dumps(config))


@pytest.mark.parametrize(
    "link",
    [
        "evaluation/post-training-greedy/.summary.tmp.json",
        "evaluation/post-training-greedy/summary.json",
        "evaluation/post-training-greedy/.episodes.tmp.parquet",
        ".lock",
        ".lock.json",
        "metrics.csv",
        "checkpoints/latest/meta.json",
    ],
)
def test_a_run_with_a_link_to_a_file_of_the_user_is_refused(run, precious, link):
    (run / link).parent.mkdir(parents=True, exist_ok=True)
    (run / link).unlink(missing_ok=True)
    (run / link).symlink_to(precious)
    for use in (evaluate, RunFolder.open):
        with pytest.raises(UserError, match=r"is a link to .*bashrc, outside of"):
            use(run)
    with pytest.raises(UserError, match="is a link"), lock_folder(run, remedy=""):
        pytest.fail("the folder was locked")


def test_a_new_run_refuses_a_prepared_folder(tmp_path, precious):
    prepared = tmp_path / "runs" / "irb120-full-ppo" / "0"
    prepared.mkdir(parents=True)
    (prepared / "checkpoints").symlink_to(precious.parent)
    with pytest.raises(UserError, match="is a link"):
        train(short(), tmp_path / "runs")


@pytest.fixture
def opened(tmp_path):
    """Names of files below the user's secrets that are opened or listed."""
    seen, secrets = [], tmp_path / "secrets"
    secrets.mkdir()
    (secrets / "id_rsa").write_text("key")

    def note(event, arguments):
        if event in ("open", "os.listdir", "os.scandir") and arguments:
            seen.extend([arguments[0]] * str(arguments[0]).startswith(str(secrets)))

    sys.addaudithook(note)
    yield secrets
    assert seen == []


@pytest.mark.parametrize("has_copy", [True, False])
def test_a_run_that_names_a_folder_of_the_user_as_graph_opens_nothing_there(
    run, opened, has_copy
):
    folder = RunFolder(run)
    edit(run, "knows", graph=str(opened))
    if has_copy:
        copy = Path(folder.config()["knows"]["graph"])
        copy.parent.mkdir(parents=True)
        copy.write_text("head,relation,tail\nmug,usedFor,drinking\n")
    load_agent(run)
    evaluate(run, **BRIEF)
    write_report([run], run.parents[2] / "report.html")


@pytest.mark.parametrize("field", ["robot", "targets"])
def test_a_run_brings_no_robot_or_object_of_its_own(run, field):
    """MuJoCo would compile the MJCF, which names files at any path."""
    own = run / "graphs" / "aa"
    shutil.copytree(ROOT / "examples" / "own_robot", own)
    name = str(own / ("scara.toml" if field == "robot" else "bowl.toml"))
    edit(run, "env", **{field: name if field == "robot" else [name]})
    for use in (evaluate, load_agent):
        with pytest.raises(
            UserError, match=r"names the description .*trusted like code"
        ):
            use(run)
    with pytest.raises(UserError, match=r"Nothing to report: .*trusted like code"):
        write_report([run], run.parents[2] / "report.html")
    find = find_robot if field == "robot" else lambda name: find_targets([name])
    find(name)  # reads, and grants nothing
    with pytest.raises(UserError, match=r"names the description .*trusted like code"):
        load_agent(run)
    assert main(["evaluate", "oracle", f"--env.{field}", name, "--episodes", "1"]) == 0
    assert name in str(RunFolder.open(run).experiment().env)


def leak(model):
    """Let a model name a file of the user, as a stranger may."""
    asset = '<asset><mesh name="leak" file="/etc/hostname"/></asset></mujoco>'
    model.write_text(model.read_text().replace("</mujoco>", asset))


def own_robot(folder):
    """A robot with an included file, an attached model, a mesh and a texture of its own."""
    shutil.copytree(ROOT / "examples" / "own_robot", folder)
    model = folder / "scara.xml"
    assets = """<asset><mesh name="extra" file="extra.obj"/>
      <texture name="extra" type="2d" file="extra.png"/><model name="extra" file="extra.xml"/>
      </asset><include file="included.xml"/></mujoco>"""
    model.write_text(model.read_text().replace("</mujoco>", assets))
    (folder / "included.xml").write_text("<mujoco><worldbody/></mujoco>")
    (folder / "extra.xml").write_text("<mujoco><worldbody/></mujoco>")
    (folder / "extra.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n")
    (folder / "extra.png").write_bytes(b"png")
    return folder / "scara.toml"


CHANGES = {
    "model": lambda folder: leak(folder / "scara.xml"),
    "description": lambda folder: (
        (folder / "scara.toml").open("a").write("\n# git pull")
    ),
    "included": lambda folder: leak(folder / "included.xml"),
    "attached": lambda folder: leak(folder / "extra.xml"),
    "mesh": lambda folder: (folder / "extra.obj").write_text("v 0 0 1\n"),
    "texture": lambda folder: (folder / "extra.png").write_bytes(b"gnp"),
    "mesh removed": lambda folder: (folder / "extra.obj").unlink(),
    "another robot": lambda folder: shutil.copy(
        folder / "bowl.toml", folder / "scara.toml"
    ),
}


@pytest.mark.parametrize("change", CHANGES)
def test_trust_in_a_robot_ends_with_a_change_of_any_of_its_files(run, tmp_path, change):
    robot = own_robot(tmp_path / "own")
    edit(run, "env", robot=str(robot))
    with pytest.raises(UserError, match="you have not used it on this machine"):
        RunFolder.open(run)
    trust([str(robot)])
    RunFolder.open(run)
    times = {file: file.stat() for file in robot.parent.iterdir()}
    CHANGES[change](robot.parent)
    for file in set(robot.parent.iterdir()) & set(times):  # as unpacking sets them
        os.utime(file, ns=(times[file].st_atime_ns, times[file].st_mtime_ns))
    with pytest.raises(
        UserError, match="has changed since you used it on this machine"
    ):
        RunFolder.open(run)
    trust([str(robot)])


FIELD = '<asset><hfield name="t" file="terrain.png" size="1 1 1 1"/></asset>'
UNLISTED = {
    "height field": ('<compiler meshdir="last"/>' + FIELD, "last/terrain.png"),
    "second folder": (
        '<compiler meshdir="first"/><compiler meshdir="last"/>',
        "last/extra.obj",
    ),
    "attached": (
        '<asset><model name="t" file="last/field.xml"/></asset>',
        "last/other/terrain.png",
    ),
}
"""What a model adds, and the file that MuJoCo opens for it and lists in another folder."""


@pytest.mark.parametrize("kind", UNLISTED)
def test_trust_ends_with_a_change_of_a_file_that_mujoco_does_not_list(
    run, tmp_path, kind
):
    """It lists a height field beside the model, and a mesh in the first folder of two."""
    robot = own_robot(tmp_path / "own")
    own = robot.parent
    terrain = np.arange(64, dtype=np.uint8).reshape(8, 8)
    for folder in (own / "first", own / "last", own / "last" / "other"):
        folder.mkdir()
        shutil.copy(own / "extra.obj", folder)
        shutil.copy(own / "extra.xml", folder)
        Image.fromarray(terrain).save(folder / "terrain.png")
    inner = f'<mujoco><compiler meshdir="other"/>{FIELD}<worldbody/></mujoco>'
    (own / "last" / "field.xml").write_text(inner)
    added, opened = UNLISTED[kind]
    model = own / "scara.xml"
    model.write_text(model.read_text().replace("</mujoco>", f"{added}</mujoco>"))
    trust([str(robot)])
    edit(run, "env", robot=str(robot))
    RunFolder.open(run)
    (own / opened).write_bytes((own / opened).read_bytes() + b" ")
    with pytest.raises(UserError, match=r"has changed since you used"):
        RunFolder.open(run)


def test_a_link_to_a_trusted_robot_trusts_no_model_beside_the_link(run, tmp_path):
    """The model of a description lies beside its name, not beside what a link leads to."""
    robot = own_robot(tmp_path / "own")
    trust([str(robot)])
    other = own_robot(tmp_path / "clone")
    leak(other.with_suffix(".xml"))
    other.unlink()
    other.symlink_to(robot)
    edit(run, "env", robot=str(other))
    with pytest.raises(UserError, match="trusted like code"):
        RunFolder.open(run)


def test_a_robot_that_cannot_be_used_is_not_trusted(run, tmp_path):
    robot = own_robot(tmp_path / "own")
    model = robot.parent / "scara.xml"
    text = model.read_text()
    model.unlink()
    edit(run, "env", robot=str(robot))
    trust([str(robot)])
    model.write_text(text)
    with pytest.raises(UserError, match="trusted like code"):
        RunFolder.open(run)


def test_a_study_of_a_stranger_brings_no_robot_of_its_own(tmp_path):
    robot = (
        shutil.copytree(ROOT / "examples" / "own_robot", tmp_path / "own")
        / "scara.toml"
    )
    study = StudyConfig(
        name="s",
        experiments=("full-fast",),
        seeds=(0,),
        overrides={"env": {"robot": str(robot)}},
    )
    (tmp_path / "s").mkdir()
    values = {"format": 1, **to_dict(study)}
    (tmp_path / "s" / "study.json").write_text(json.dumps(values))
    file = tmp_path / "s.toml"
    file.write_text(
        'name = "s"\nexperiments = ["full-fast"]\nseeds = [0]\n'
        f"overrides.env.robot = '{robot}'\n"
    )
    for source in (tmp_path / "s", file):
        with pytest.raises(UserError, match="trusted like code"):
            read_study(source)
    write_study(study, tmp_path / "s")
    for source in (tmp_path / "s", file):
        assert read_study(source) == study


@pytest.mark.parametrize(
    "name", ["../../x", "/tmp/x", "$(touch x)", "a\nb", "..", "", "\u00e4"]
)
def test_names_of_folders_are_no_paths(run, name):
    edit(run, name=name)
    with pytest.raises(UserError, match="name must be a name of letters"):
        evaluate(run, **BRIEF)
    with pytest.raises(UserError, match="name must be a name of letters"):
        experiment_config("full-fast", name=name)
    with pytest.raises(UserError, match="label must be a name of letters"):
        EvaluationConfig(label=name)


def test_a_report_writes_through_no_link(run, precious):
    runs, secrets = run.parents[1], precious.parent
    (runs / ".report.tmp.html").symlink_to(precious)
    (runs / "report.html").symlink_to(precious)
    write_report([run], runs / "report.html")
    shutil.rmtree(runs / "report-data")
    (runs / "report-data").symlink_to(secrets)
    report = json.loads((runs / "report.json").read_text())
    report["tables"]["bashrc"] = {}
    (runs / "report.json").write_text(json.dumps(report))
    (secrets / "bashrc.csv").write_text("mine")
    with pytest.raises(UserError, match="no report wrote it"):
        write_report([run], runs / "report.html")
    assert (secrets / "bashrc.csv").read_text() == "mine"
    (secrets / "bashrc.csv").unlink()


class Hang(BaseException):
    """No `Exception`, so that nobody takes it for a damaged file."""


@pytest.fixture
def no_hang():
    """Ends a test that waits for ever, as a reader of a FIFO does."""

    def end(*_):
        raise Hang("it waits for ever")

    signal.signal(signal.SIGALRM, end)
    signal.alarm(60)
    yield
    signal.alarm(0)


def locked(run):
    is_locked(run)
    with lock_folder(run, remedy=""):
        pass


FIFO_USES = {
    "load": load_agent,
    "evaluate": lambda run: evaluate(run, **BRIEF),
    "report": lambda run: write_report([run], run.parents[2] / "report.html"),
    "lock": locked,
    "train": lambda run: train(short(), run.parents[1], resume=True),
}
FIFOS = [
    "config.json",
    "knowledge.safetensors",
    "provenance.json",
    "metrics.csv",
    "evaluations.csv",
    "checkpoints/best/meta.json",
    "checkpoints/best/policy.safetensors",
    "checkpoints/latest/meta.json",
    "evaluation/post-training-greedy/summary.json",
    "evaluation/post-training-greedy/episodes.parquet",
    ".lock",
    ".lock.json",
]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no FIFO")
@pytest.mark.parametrize("use", FIFO_USES)
@pytest.mark.parametrize("name", FIFOS)
def test_a_fifo_in_a_run_lets_nothing_wait(run, no_hang, name, use):
    """As `tar` unpacks them."""
    if use == "train":
        (run.parents[1] / short().name).mkdir()
        run = run.rename(run.parents[1] / short().name / "0")
    path = run / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    os.mkfifo(path)
    with suppress(UserError):
        FIFO_USES[use](run)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no FIFO")
@pytest.mark.parametrize(
    "command",
    [
        "knowledge show --graph x.ttl --objects mug",
        "knowledge show --graph x.csv.gz --objects mug",
        "ask mug --graph x.ttl",
        "evaluate oracle --env.robot x.toml",
        "doctor --robot x.toml",
        "doctor --robot x.urdf",
        "doctor --robot irb120 --camera x.png",
        "study run x.toml",
        "study unpack x.knowarm-study.tar.xz",
        "train irb120-choose-answers-fast --perception x.safetensors",
        "export run --joint-map x.toml",
        "benchmark verify x.json",
    ],
)
def test_a_fifo_is_no_input_of_a_command(
    run, tmp_path, no_hang, capsys, monkeypatch, command
):
    monkeypatch.chdir(tmp_path)
    Path("run").symlink_to(run)
    words = command.split()
    os.mkfifo(next(word for word in words if word.startswith("x.")))
    assert main(words) == 2
    said = capsys.readouterr()
    assert "FIFO" in said.out + said.err
    assert said.err.count("\n") == 1


def socket_file(path):
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))


NO_FILES = {
    "FIFO": lambda path: os.mkfifo(path),  # which Windows lacks
    "socket": socket_file,
    "folder": Path.mkdir,
    "dangling link": lambda path: path.symlink_to(path.parent / "nowhere"),
    "device": lambda path: path.symlink_to("/dev/zero"),
}
MJCF = "<mujoco>%s<worldbody><geom size='1'/></worldbody></mujoco>"
XACRO = """<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro">%s<link name="b"/></robot>"""
URDF = """<robot name="a"><link name="b"><visual><geometry><mesh filename="%s"/></geometry></visual>
</link></robot>"""
INCLUDED = {
    "part": ("a.xml", MJCF % "<include file='x.xml'/>", "x.xml"),
    "model": ("a.xml", MJCF % "<asset><model name='m' file='x.xml'/></asset>", "x.xml"),
    "mesh": ("a.xml", MJCF % "<asset><mesh file='x.stl'/></asset>", "x.stl"),
    "texture": (
        "a.xml",
        MJCF % "<asset><texture type='2d' file='x.png'/></asset>",
        "x.png",
    ),
    "xacro": ("a.xacro", XACRO % "<xacro:include filename='x.xacro'/>", "x.xacro"),
    "YAML": (
        "a.xacro",
        XACRO % "<a>${xacro.load_yaml('x.yaml')}</a>",
        "x.yaml",
    ),
    "URDF mesh": ("a.urdf", URDF % "x.stl", "x.stl"),
    "COLLADA": ("a.urdf", URDF % "x.dae", "x.dae"),
    "package": ("a.urdf", URDF % "package://p/x.stl", "package.xml"),
}
"""Robots' files of which a part may be no file: name, content and name of the part."""
NO_FILES_INCLUDED = combinations(tuple(INCLUDED), tuple(NO_FILES))
for part in INCLUDED:
    if (part, "FIFO") not in NO_FILES_INCLUDED:  # for which a parser may wait for ever
        NO_FILES_INCLUDED.append((part, "FIFO"))


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="is no Linux")
@pytest.mark.parametrize(("part", "kind"), NO_FILES_INCLUDED)
def test_a_part_of_a_robot_that_is_no_file_is_refused_at_once(
    tmp_path, no_hang, capsys, monkeypatch, part, kind
):
    name, text, included = INCLUDED[part]
    if name.endswith("xacro"):
        pytest.importorskip("xacro")
    monkeypatch.chdir(tmp_path)
    Path(name).write_text(text)
    NO_FILES[kind](Path(included))
    assert main(["doctor", "--robot", name]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith("knowarm: ")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no FIFO")
@pytest.mark.parametrize("kind", NO_FILES)
def test_a_part_of_a_split_graph_that_is_no_file_is_no_missing_one(
    tmp_path, no_hang, kind
):
    (tmp_path / "train.txt").write_text("mug\tisA\tcup\n")
    NO_FILES[kind](tmp_path / "valid.txt")
    with pytest.raises(UserError, match=r"valid\.txt"):
        read_graph(tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no FIFO")
def test_an_output_replaces_a_fifo(tmp_path, no_hang):
    os.mkfifo(tmp_path / "out.json")
    write_json(tmp_path / "out.json", {"a": 1})
    assert read_json(tmp_path / "out.json") == {"a": 1}
