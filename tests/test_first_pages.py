"""The pages to look at before installing: small, whole, linked, and what their script writes."""

import re

import numpy as np
import pytest

from scripts.build_first_pages import PAGES, QUESTION, main
from tests.source_tree import ROOT

NAMES = ("answer.html", "report.html")
MOST_BYTES = 400_000
NUMBER = re.compile(r"\d+(?:\.\d+)?")
DATA = re.compile(r"data:[\w/]+;base64,[\w/+=]+")


def test_they_are_small_and_linked_from_the_first_page():
    index = (ROOT / "docs" / "index.md").read_text("utf-8")
    for name in NAMES:
        assert f'href="_static/{name}"' in index
    assert sum((PAGES / name).stat().st_size for name in NAMES) <= MOST_BYTES
    assert QUESTION in (PAGES / "answer.html").read_text("utf-8")


@pytest.mark.parametrize("name", NAMES)
def test_a_page_loads_nothing_and_leads_to_no_missing_file(name):
    text = (PAGES / name).read_text("utf-8")
    targets = re.findall(r'(?:href|src)="([^"]*)"', text)
    assert targets
    leading = [each for each in targets if not each.startswith(("data:", "#"))]
    assert leading == []
    anchors = {each[1:] for each in targets if each.startswith("#")}
    assert anchors <= {"", *re.findall(r'id="([^"]*)"', text)}


@pytest.mark.slow(60)
def test_the_script_writes_them(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["build_first_pages", "--out", str(tmp_path)])
    main()
    for name in NAMES:
        made, committed = (
            DATA.sub("", (folder / name).read_text("utf-8"))
            for folder in (tmp_path, PAGES)
        )
        # Last digits may differ between processors.
        assert NUMBER.split(made) == NUMBER.split(committed), name
        numbers = [np.array(NUMBER.findall(page), float) for page in (made, committed)]
        np.testing.assert_allclose(*numbers, rtol=1e-3, atol=0.02)
