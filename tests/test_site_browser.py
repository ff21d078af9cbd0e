"""Pages of the documentation in a real browser: code wraps, and nothing is hidden by scripts."""

import shutil

import pytest

from tests.report.test_browser import browser, open_page  # noqa: F401
from tests.source_tree import ROOT

pytestmark = pytest.mark.browser
PAGE = """<!doctype html><html><head><link rel="stylesheet" href="site.css">
<script src="site.js"></script></head><body><article class="bd-article"><section id="answer">
<h1>Answer</h1><section id="one"><h2>One<a>#</a></h2><pre>knowarm train {}</pre></section>
</section></article></body></html>"""


def test_code_is_not_cut_and_sections_are_shown(tmp_path, open_page):  # noqa: F811
    for name in ("site.css", "site.js"):
        shutil.copy(ROOT / "docs/_static" / name, tmp_path)
    path = tmp_path / "answer.html"
    path.write_text(PAGE.format("--option " * 60))
    page = open_page(path, width=390)
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    assert page.evaluate("[...document.querySelectorAll('[hidden]')].length") == 0
    code = "document.querySelector('pre')"
    assert page.evaluate(f"{code}.scrollWidth <= {code}.clientWidth")
