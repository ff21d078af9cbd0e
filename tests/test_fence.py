"""Parsers on hostile input: the process of KnowArm goes on, and the error is one line."""

import ctypes
import gc
import os
import subprocess
import sys
import threading
import time
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import pytest

from knowarm import fence
from knowarm.cli.main import main
from knowarm.errors import UserError
from knowarm.fence import Fence, ParserError, fenced
from knowarm.knowledge import household, read_graph
from knowarm.knowledge.queries.sparql import sparql
from knowarm.own_robot.urdf import as_mjcf
from knowarm.world.scene.mjcf import read_mjcf
from tests.thorough import thorough

DEPTH = 20_000
FEWER = 8_000
PREFIX = "http://example.org/"
NESTED = {
    "omn": "Class: <{p}A>\n  SubClassOf: " + "not (" * DEPTH + "<{p}B>" + ")" * DEPTH,
    "ofn": "Ontology(<{p}o>\nSubClassOf(<{p}A> "
    + "ObjectComplementOf(" * DEPTH
    + "<{p}B>"
    + ")" * DEPTH
    + "))",
    "owx": '<Ontology xmlns="http://www.w3.org/2002/07/owl#"><SubClassOf><Class IRI="{p}A"/>'
    + "<ObjectComplementOf>" * DEPTH
    + '<Class IRI="{p}B"/>'
    + "</ObjectComplementOf>" * DEPTH
    + "</SubClassOf></Ontology>",
    "jsonld": '{{"http://a/b":' * DEPTH + '{{"@id":"{p}B"}}' + "}}" * DEPTH,
    "arrays.jsonld": '{{"http://a/b":' + "[" * DEPTH + "1" + "]" * DEPTH + "}}",
    # Of which the parser takes the square of the time
    "lists.jsonld": '{{"http://a/b":'
    + '{{"@list":[' * FEWER
    + "1"
    + "]}}" * FEWER
    + "}}",
    "some.omn": "Class: <{p}A>\n  SubClassOf: "
    + "<{p}r> some (" * DEPTH
    + "<{p}B>"
    + ")" * DEPTH,
    "inverse.ofn": "Ontology(<{p}o>\nSubClassOf(<{p}A> "
    + "ObjectSomeValuesFrom(<{p}r> " * DEPTH
    + "<{p}B>"
    + ")" * DEPTH
    + "))",
}
NESTED["star.nt"] = "<{p}a> <{p}b> " + "<<( <{p}a> <{p}b> " * DEPTH
NESTED["star.nt"] += "<{p}c>" + " )>>" * DEPTH + " .\n"
NESTED["star.ttl"] = NESTED["star.nt"]
HEAD = {"omn": "Ontology: <{p}o>\n"}


@pytest.mark.parametrize("name", NESTED)
def test_a_graph_that_nests_deep_is_one_line(tmp_path, name, capsys):
    suffix = name.rpartition(".")[2]
    if suffix.startswith("o"):
        pytest.importorskip("pyhornedowl")
    path = tmp_path / f"deep.{suffix}"
    text = (HEAD.get(suffix, "") + NESTED[name]).format(p=PREFIX)
    path.write_text(text)
    command = ["knowledge", "show", "--graph", str(path), "--objects", "A"]
    assert main(command) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "deep." in error


def test_a_graph_that_nests_as_people_write_is_read(tmp_path):
    pytest.importorskip("pyhornedowl")
    path = tmp_path / "graph.omn"
    text = (HEAD["omn"] + NESTED["omn"]).format(p=PREFIX)
    path.write_text(
        text.replace("not (" * DEPTH, "not (" * 9).replace(")" * DEPTH, ")" * 9)
    )
    assert len(read_graph(path))


def test_rdf_xml_that_nests_deep_ends_at_its_limit(tmp_path, second):
    """Of which the parser takes the square of the time."""
    path = tmp_path / "deep.rdf"
    begin = "<e:A><e:p>" * (2 * DEPTH)
    end = "</e:p></e:A>" * (2 * DEPTH)
    names = (
        'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" xmlns:e="http://e/"'
    )
    path.write_text(f"<rdf:RDF {names}>{begin}{end}</rdf:RDF>")
    with pytest.raises(UserError, match=r"deep\.rdf.*more than \d s"):
        read_graph(path)


@pytest.fixture
def second(monkeypatch):
    """A second of processor time for all that is fenced."""
    monkeypatch.setattr(fence, "SECONDS", 1)
    monkeypatch.setattr(fence, "WAIT", 100)


def hang():
    while True:
        pass


def fill():
    return b"x" * 2**40


def overflow():
    ctypes.string_at(0)


def fail():
    raise KeyError("mine")


def refuse():
    raise UserError("no")


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (hang, "more than 1 s .*SIGXCPU"),
        (fill, "2.0 GiB"),
        (overflow, "SIGSEGV"),
        (lambda: os._exit(3), "exit code 3"),
        (lambda: lambda: 0, "exit code 1"),  # it cannot be sent
        (lambda: sys.exit(0), "exit code 1"),
    ],
)
def test_what_crosses_a_limit_is_an_error(second, function, words):
    with pytest.raises(ValueError, match=words) as error:
        fenced(function)
    assert not isinstance(error.value, ParserError)


def test_what_a_function_raises_is_its_message():
    with pytest.raises(ParserError, match="mine"):
        fenced(fail)
    with pytest.raises(UserError, match="no"):
        fenced(refuse)
    assert fenced(bytes, 2**24) == bytes(2**24)
    assert fenced(fenced, sum, [1, 2]) == 3


def test_a_process_is_kept_until_it_crosses_a_limit(second):
    calls = []

    def count(ends=False):
        calls.append(0)
        return os.abort() if ends else len(calls)

    counting = Fence(count)
    assert [counting(), counting()] == [1, 2]
    with pytest.raises(ValueError, match="SIGABRT"):
        counting(True)
    assert counting() == 1
    assert calls == []
    counting.close()


def test_time_is_that_of_a_call(second):
    def work():
        begin = time.process_time()
        while time.process_time() < begin + 0.7:
            pass

    working = Fence(work)
    for _ in range(3):
        working()


def test_a_parser_that_takes_too_long_is_ended(monkeypatch):
    monkeypatch.setattr(fence, "SECONDS", 1)
    monkeypatch.setattr(fence, "WAIT", 2)
    looks = []
    monkeypatch.setattr(fence, "_waiting", lambda process: looks.append(time.sleep(1)))
    with pytest.raises(ValueError, match="takes more than 2 s"):
        fenced(time.sleep, 300)
    assert len(looks) <= 2


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="is no Linux")
def test_a_parser_that_waits_is_ended_at_once():
    begin = time.monotonic()
    with pytest.raises(ValueError, match="it waits for a FIFO"):
        fenced(time.sleep, 300)
    assert time.monotonic() - begin < 60


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="is no Linux")
@pytest.mark.parametrize("pause", [0, 0.1])
def test_a_thread_that_works_is_waited_for(pause):
    def wait():
        thread = threading.Thread(target=count, daemon=True)
        thread.start()
        thread.join()
        return 3

    def count():  # with pauses, as who reads from a slow network
        end = time.monotonic() + 3 * fence.IDLE * fence.LOOK
        while time.monotonic() < end:
            time.sleep(pause)

    assert fenced(wait) == 3


def test_a_fork_frees_nothing_that_it_inherits(tmp_path):
    path = tmp_path / "freed"
    parent = os.getpid()

    class Pool:
        """Such as threads of a library, which the fork lacks and would wait for."""

        def __init__(self):
            self.itself = self

        def __del__(self):
            if os.getpid() != parent:
                path.touch()

    kept = Fence(int)
    kept()
    process = kept._process
    gc.disable()
    Pool()
    try:
        fenced(gc.collect)
        fenced(kept.close)
    finally:
        gc.enable()
    assert not path.exists()
    kept()
    assert kept._process == process


class Slow:
    @cached_property
    def value(self):
        time.sleep(0.5)
        return 3


def test_a_fork_waits_for_no_thread_that_computes_a_property(monkeypatch):
    monkeypatch.setattr(fence, "SECONDS", 1)
    monkeypatch.setattr(fence, "WAIT", 20)
    thread = threading.Thread(target=lambda: Slow().value)
    thread.start()
    time.sleep(0.1)
    assert fenced(lambda: (Slow().value, isinstance(Slow.value, cached_property))) == (
        3,
        True,
    )
    thread.join()


def test_an_interrupt_ends_the_process(monkeypatch):
    waiting = Fence(time.sleep)
    waiting(0)
    process = waiting._process

    def interrupted(seconds):
        raise KeyboardInterrupt

    monkeypatch.setattr(waiting._pipe, "poll", interrupted)
    with pytest.raises(KeyboardInterrupt):
        waiting(100)
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)


def test_the_process_ends_with_the_one_that_started_it():
    code = (
        "import os, time\n"
        "from knowarm.fence import Fence\n"
        "print(Fence(os.getpid)(), flush=True)\n"
        "os.abort()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE)
    process = int(done.stdout)
    deadline = time.monotonic() + 20
    while Path(f"/proc/{process}").exists():
        assert time.monotonic() < deadline
        time.sleep(0.05)


CROSS_JOIN = "SELECT (COUNT(*) AS ?n) { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i . ?j ?k ?l }"


def test_a_query_that_takes_too_long_is_one_line_while_others_are_answered(second):
    errors = []

    def join():
        with pytest.raises(UserError, match="needs more than 1 s") as error:
            sparql(household(), CROSS_JOIN)
        errors.append(str(error.value))

    count = thorough(2, 3)
    threads = [threading.Thread(target=join) for _ in range(count)]
    for thread in threads:
        thread.start()
    assert sparql(household(), "ASK { :mug :usedFor :drinking }").rows == (("yes",),)
    assert not errors
    for thread in threads:
        thread.join()
    assert len(errors) == count
    assert not any("\n" in error for error in errors)


XACRO = """<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro">
<link name="${%s}"/></robot>"""
BODY = "<mujoco><worldbody>%s</worldbody></mujoco>"
ROBOTS = {
    "power.xacro": XACRO % "9**9**9**9",
    "text.xacro": XACRO % "'a' * 10**10",
    "list.xacro": XACRO % "[0] * 10**10",
    "loop.xacro": XACRO % "sum([i for i in range(10**10)])",
    "macro.xacro": XACRO % "1"
    + '<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/></robot>',
    "deep.urdf": "<robot>" + "<a>" * 10**5 + "</a>" * 10**5 + "</robot>",
    "deep.xml": BODY % ("<body>" * 10**5 + "</body>" * 10**5),
    "field.xml": "<mujoco><asset><hfield name='a' size='1 1 1 1' nrow='90000' "
    "ncol='90000'/></asset></mujoco>",
    "replicate.xml": BODY
    % "<replicate count='1000000000'><geom size='1'/></replicate>",
    "memory.xml": "<mujoco><size memory='900T'/>" + BODY % "" + "</mujoco>",
    "texture.xml": "<mujoco><asset><texture name='a' type='2d' builtin='flat' "
    "width='200000' height='200000'/></asset></mujoco>",
    "self.xml": "<mujoco><include file='self.xml'/></mujoco>",
}


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_that_computes_without_end_is_one_line(tmp_path, name, second):
    if name.endswith("xacro"):
        pytest.importorskip("xacro")
    path = tmp_path / name
    path.write_text(ROBOTS[name])
    read = partial(as_mjcf, path, tmp_path / "made")
    if name.endswith("xml"):
        read = partial(read_mjcf, path, "Robot 'a'")
    with pytest.raises(UserError, match=name) as error:
        read()
    assert "\n" not in str(error.value)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no FIFOs")
def test_a_mesh_that_is_no_file_is_refused_at_once(tmp_path, second):
    os.mkfifo(tmp_path / "a.stl")
    mesh = "<asset><mesh file='a.stl'/></asset>"
    body = "<worldbody><geom type='mesh' mesh='a'/></worldbody>"
    path = tmp_path / "arm.xml"
    path.write_text(f"<mujoco>{mesh}{body}</mujoco>")
    with pytest.raises(UserError, match=r"a\.stl: it is a FIFO"):
        read_mjcf(path, "Robot 'a'")


ENDLESS = """<ir_version: 9, opset_import: ["" : 17]>
endless (float[n, 6] joint_targets) => (float[n, 6] a) <bool yes = {1}> {
  a = Loop <body = body (int64 i, bool goes, float[n, 6] x) => (bool on, float[n, 6] y) {
    on = Identity(goes)
    y = Identity(x)
  }> (, yes, joint_targets)
}"""


def test_an_onnx_file_that_computes_without_end_is_one_line(tmp_path, second):
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    from onnx import parser

    from knowarm.benchmark.external import OnnxPolicy

    path = tmp_path / "loop.onnx"
    onnx.save(parser.parse_model(ENDLESS), path)
    policy = OnnxPolicy(path)
    policy._state = {}
    with pytest.raises(UserError, match=r"loop\.onnx.*needs more than 1 s") as error:
        policy.act({"joint_targets": np.zeros((1, 6), np.float32)})
    assert "\n" not in str(error.value)


def test_a_mistake_in_an_ontology_keeps_its_line(tmp_path):
    pytest.importorskip("pyhornedowl")
    path = tmp_path / "graph.ofn"
    path.write_text(f"Ontology(<{PREFIX}o>\nSubClassOf(<{PREFIX}A> \n")
    with pytest.raises(UserError, match="not well-formed OWL functional syntax"):
        read_graph(path)
