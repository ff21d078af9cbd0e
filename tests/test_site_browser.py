"""A long page of the documentation in a real browser: one section at a time, all by print."""

import shutil

import pytest

from tests.report.test_browser import browser, open_page  # noqa: F401
from tests.source_tree import ROOT

pytestmark = pytest.mark.browser
PAGE = """<!doctype html><html><head><link rel="stylesheet" href="site.css">
<script src="site.js"></script></head><body><article class="bd-article"><section id="answer">
<h1>Answer</h1><p id="intro">Short.</p>
<section id="one"><h2>One<a>#</a></h2><p>First.</p></section>
<section id="two"><h2>Two<a>#</a></h2><p>Second.</p>
<section id="deep"><h3>Deep</h3><pre>knowarm train {}</pre></section></section>
</section></article></body></html>"""


def test_a_long_page_shows_the_section_of_its_address(tmp_path, open_page):  # noqa: F811
    for name in ("site.css", "site.js"):
        shutil.copy(ROOT / "docs/_static" / name, tmp_path)
    for name in ("answer", "other"):
        path = tmp_path / f"{name}.html"
        path.write_text(PAGE.format("--option " * 60))
    page = open_page(tmp_path / "answer.html", width=390)

    def shown():
        names = ("intro", "one", "two")
        return [name for name in names if not page.evaluate(f"{name}.hidden !== false")]

    assert shown() == ["intro"]
    page.click("nav.sections >> text=Two")
    assert shown() == ["two"]
    page.evaluate("location.hash = '#deep'")
    page.wait_for_function("!two.hidden")
    assert shown() == ["two"]
    page.click("nav.sections >> text=Start")
    assert shown() == ["intro"]
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    other = open_page(tmp_path / "other.html", width=390)
    assert other.evaluate("[...document.querySelectorAll('[hidden]')].length") == 0
    code = "document.querySelector('pre')"
    assert other.evaluate(f"{code}.scrollWidth <= {code}.clientWidth")
