"""Parsers on hostile input: the process of KnowArm goes on, and the error is one line."""

import subprocess
import time

import pytest

from knowarm import fence
from knowarm.cli.main import main
from knowarm.errors import UserError
from knowarm.fence import ParserError, fenced
from knowarm.knowledge import read_graph

DEPTH = 20_000
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
    "lists.jsonld": '{{"http://a/b":'
    + '{{"@list":[' * DEPTH
    + "1"
    + "]}}" * DEPTH
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
HEAD = {"omn": "Ontology: <{p}o>\n"}


@pytest.mark.parametrize("name", NESTED)
def test_a_graph_that_nests_deep_is_one_line(tmp_path, name, capsys):
    if not name.endswith("jsonld"):
        pytest.importorskip("pyhornedowl")
    suffix = name.rpartition(".")[2]
    path = tmp_path / f"deep.{suffix}"
    text = (HEAD.get(suffix, "") + NESTED[name]).format(p=PREFIX)
    path.write_text(text)
    command = ["knowledge", "show", "--graph", str(path), "--objects", "A"]
    assert main(command) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "deep." in error


@pytest.mark.parametrize("name", ["omn", "ofn"])
def test_a_graph_that_nests_as_people_write_is_read(tmp_path, name):
    pytest.importorskip("pyhornedowl")
    path = tmp_path / f"graph.{name}"
    deep = HEAD.get(name, "") + NESTED[name]
    for word in ("not (", "ObjectComplementOf(", ")"):
        deep = deep.replace(word * DEPTH, word * 10)
    path.write_text(deep.format(p=PREFIX))
    assert len(read_graph(path))


HANGS = "def parse(data):\n    while True: pass\n"
FILLS = "def parse(data):\n    return b'x' * 2**40\n"
DEEP = "import ctypes\ndef parse(data):\n    ctypes.string_at(0)\n"
FAILS = "def parse(data):\n    raise KeyError('mine')\n"
EXITS = "import os\ndef parse(data):\n    os._exit(3)\n"
ECHOES = "def parse(data):\n    return data[::-1]\n"


@pytest.mark.parametrize(
    ("parser", "words"),
    [
        (HANGS, "memory or time"),
        (FILLS, "memory"),
        (DEEP, "SIGSEGV"),
        (EXITS, "exit code"),
    ],
)
def test_a_parser_that_crosses_a_limit_is_an_error(monkeypatch, parser, words):
    monkeypatch.setattr(fence, "SECONDS", 1.0)
    with pytest.raises(ValueError, match=words) as error:
        fenced(parser, b"")
    assert not isinstance(error.value, ParserError)


def test_what_a_parser_raises_is_its_message():
    with pytest.raises(ParserError, match="mine"):
        fenced(FAILS, b"")
    assert fenced(ECHOES, b"abc") == b"cba"
    assert fenced(ECHOES, bytes(2**24)) == bytes(2**24)


def test_a_parser_that_waits_is_ended(monkeypatch):
    monkeypatch.setattr(fence, "SECONDS", 0.4)
    begin = time.monotonic()
    with pytest.raises(ValueError, match="takes 2 s"):
        fenced("import time\ndef parse(data):\n    time.sleep(100)\n", b"")
    assert time.monotonic() - begin < 30


def test_an_interrupt_ends_the_parser(monkeypatch):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(subprocess, "run", interrupted)
    with pytest.raises(KeyboardInterrupt):
        fenced(ECHOES, b"")


def test_a_mistake_in_an_ontology_keeps_its_line(tmp_path):
    pytest.importorskip("pyhornedowl")
    path = tmp_path / "graph.ofn"
    path.write_text(f"Ontology(<{PREFIX}o>\nSubClassOf(<{PREFIX}A> \n")
    with pytest.raises(UserError, match="not well-formed OWL functional syntax"):
        read_graph(path)
