"""Text of strangers in every output format, by readers of these formats."""

import csv
import io
import json
import re
import shutil
import time
import xml.etree.ElementTree as ElementTree

import pytest

from knowarm.errors import printable
from knowarm.escapes import csv_cell, latex, markdown
from knowarm.report import write_report
from knowarm.svg import escape
from tests.source_tree import ROOT

FORMULAS = [
    '=HYPERLINK("http://127.0.0.1:9/";"x")',
    "+1+cmd|' /C calc'!A0",
    "-2+3+cmd|' /C calc'!A0",
    "@SUM(1+1)*cmd|' /C calc'!A0",
    "\t=1+1",
    "\r=1+1",
    "\n=1+1",
    " =1+1",
    "\ufeff=1+1",
    "\uff1d1+1",
    "\uff0b1+1",
    "\u200b@A1",
    "\u2060=1+1",
    "\xad=1+1",
    "\u202e=1+1",
    "\x00=1+1",
    "\x1b\x7f\u180e=1+1",
    "name;=1+1",
    "name\t=1+1",
    "name,\n=1+1",
    "-",
    "=",
]
TEXTS = [
    "<script>fetch('http://127.0.0.1:9/')</script>",
    "\"><img src=http://127.0.0.1:9/ onerror='x'>",
    "![x](http://127.0.0.1:9/x.png)",
    "[x](javascript:alert(1))",
    "a | b\n| c |",
    "&lt;b&gt;",
    "\x1b[2Jx\x07\x9b",
    "`code` *b* _i_ ~s~ $x$",
    "\x00\x0b\ud800\ufffe",
    "\u202ex",
    *FORMULAS,
]


def cells(text):
    """Split at everything that a spreadsheet may take for the end of a cell."""
    return re.split(r"[,;|\t\r\n]", text)


@pytest.mark.parametrize("text", TEXTS, ids=ascii)
def test_no_cell_of_a_csv_is_a_formula(text):
    for cell in cells(csv_cell(text)):
        bare = "".join(filter(str.isprintable, cell)).strip()
        assert not bare.startswith(tuple("=+-@\uff1d\uff0b\uff0d\uff20")), cell


def test_a_long_cell_does_not_take_the_square_of_its_time():
    begin = time.process_time()
    assert csv_cell("\t" * 20_000) == "\t" * 20_000
    assert time.process_time() - begin < 2


@pytest.mark.parametrize("text", ["-1", "+1.5", "-1e-05", "1", "", "mug", "a-b", "x=1"])
def test_numbers_and_plain_names_stay_in_a_csv(text):
    assert csv_cell(text) == text


@pytest.mark.parametrize("text", TEXTS, ids=ascii)
def test_markdown_has_no_markup_of_the_text(text):
    escaped = markdown(text)
    assert "\n" not in escaped
    assert not set(re.sub(r"&#\d+;", "", escaped)) & set("\\`*_[]<>!|&~$\"'\x1b")


@pytest.mark.parametrize(
    "text", [*TEXTS, r"\input{/etc/passwd} %x & #1 ^_~"], ids=ascii
)
def test_latex_has_no_command_cell_or_comment_of_the_text(text):
    escaped = latex(text)
    assert "\n" not in escaped
    allowed = r"\\text(backslash|asciitilde|asciicircum)\{\}|\\[{}$&#_%]|\$-\$"
    assert not set(re.sub(allowed, "", escaped)) & set("\\{}$&#^_%~")


@pytest.mark.parametrize("text", TEXTS, ids=ascii)
def test_markup_is_the_text_of_its_element(text):
    element = ElementTree.fromstring(f"<t>{escape(text)}</t>")
    assert len(element) == 0


@pytest.mark.parametrize("text", TEXTS, ids=ascii)
def test_a_terminal_acts_on_nothing(text):
    assert printable(text).isprintable()


def test_the_csv_of_a_report_on_a_run_of_a_stranger_has_no_formulas(tmp_path):
    run = shutil.copytree(
        ROOT / "zoo" / "irb120-full-fast", tmp_path / "runs" / "x" / "0"
    )
    path = run / "provenance.json"
    values = json.loads(path.read_text())
    values["commit"] = FORMULAS[0]
    path.write_text(json.dumps(values))
    page = write_report([run], tmp_path / "report.html")
    assert '"=HYPERLINK"' in page.with_suffix(".json").read_text()
    written = 0
    for file in (tmp_path / "report-data").glob("*.csv"):
        for row in csv.reader(io.StringIO(file.read_text("utf-8"))):
            written += sum("'=HYPERLINK" in cell for cell in row)
            assert not [cell for cell in row if re.match(r"\s*[=+@]", cell)], file
    assert written
