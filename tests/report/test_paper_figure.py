"""`knowarm figure`: drawings and tables of runs for a paper."""

import re
import xml.etree.ElementTree as ElementTree

import pytest
from PIL import Image

from knowarm.cli.main import main
from knowarm.escapes import latex
from knowarm.reading import read_json
from knowarm.report.figure import COLOURS
from knowarm.svg import style_sheet

pytestmark = pytest.mark.usefixtures("unfenced")


@pytest.fixture(scope="module")
def sentence(made):
    (first, *_) = read_json(made.page.with_suffix(".json"))["verdicts"]
    return first["sentence"]


def figure(made, out, *options):
    return main(["figure", str(made.runs[0].parents[1]), "--out", str(out), *options])


def test_colours_are_those_of_the_report_on_white():
    assert COLOURS["c-blue"] == "#2166ac"
    classes = set(re.findall(r"\.(c-\w+) {", style_sheet()))
    assert classes <= COLOURS.keys()


def test_a_table_has_the_numbers_and_the_verdict_of_the_report(
    made, sentence, tmp_path, capsys
):
    tex, plain = tmp_path / "t.tex", tmp_path / "t.md"
    assert figure(made, tex) == figure(made, plain) == 0
    assert f"Caption: {sentence}\n" in capsys.readouterr().out
    rows = read_json(made.page.with_suffix(".json"))["tables"]["summary"]["rows"]
    text = tex.read_text()
    assert latex(sentence) in text
    lines = [line for line in text.splitlines() if line.endswith(r" \\")]
    assert len(lines) == len(rows)
    for row, line in zip(rows, lines, strict=True):
        assert f" & {row['agent']} & {100 * row['success']:.1f} \\% " in line
    assert len(plain.read_text().splitlines()) == 4 + len(rows)


@pytest.mark.parametrize("kind", ["curves", "bars", "films"])
def test_a_drawing_has_agents_caption_and_the_colours_of_the_report(
    made, sentence, tmp_path, kind
):
    pytest.importorskip("matplotlib")
    out = tmp_path / "a figure.svg"
    assert figure(made, out, "--kind", kind) == 0
    first = out.read_bytes()
    texts = [text.strip() for text in ElementTree.fromstring(first).itertext()]
    assert {"bm", "full"} <= set(texts)
    assert sentence.split(": on ")[0] in " ".join(texts)
    if kind != "films":
        assert COLOURS["c-blue"] in first.decode()
        assert "100 %" in " ".join(texts).replace("\u202f", " ")
    if kind == "bars":  # what all kinds share
        assert figure(made, out, "--kind", kind) == 0
        assert out.read_bytes() == first
        assert figure(made, out, "--kind", kind, "--no-caption") == 0
        assert b"Does the" not in out.read_bytes()


def test_a_pdf_and_a_png_are_what_their_names_say(made, tmp_path):
    pytest.importorskip("matplotlib")
    assert figure(made, tmp_path / "f.pdf") == figure(made, tmp_path / "f.png") == 0
    assert (tmp_path / "f.pdf").read_bytes()[:5] == b"%PDF-"
    assert Image.open(tmp_path / "f.png").width > 1_000


@pytest.mark.parametrize(
    ("out", "options", "words"),
    [
        ("f.jpg", [], "ends in .pdf, .svg, .png, .tex, .md, got 'f.jpg'"),
        ("f.tex", ["--kind", "bars"], "has no kind: leave it out"),
        ("f.svg", ["--kind", "bar"], "Did you mean 'bars'?"),
    ],
)
def test_a_mistake_is_one_line(made, tmp_path, capsys, out, options, words):
    assert figure(made, tmp_path / out, *options) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_runs_without_an_evaluation_have_curves_only(reach_run, tmp_path, capsys):
    run = str(reach_run.folder.path)
    for suffix, kind in ((".tex", []), (".svg", ["--kind", "bars"])):
        out = str(tmp_path / f"f{suffix}")
        assert main(["figure", run, "--out", out, *kind]) == 2
        assert "run `knowarm evaluate RUN` first" in capsys.readouterr().err
