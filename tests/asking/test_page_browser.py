"""The page of a question in a real browser, at two widths: all of it can be read and clicked."""

import pytest

from knowarm.asking.asker import Asker
from knowarm.asking.page import page
from knowarm.experiment.load import load_agent
from tests.asking.test_offered import RUN
from tests.report.test_browser import SIZES, browser, open_page  # noqa: F401
from tests.thorough import combinations

pytestmark = pytest.mark.browser

GRAPH = """head,relation,tail,confidence
bottle,isA,vessel,
mug,isA,dish,
mug,usedFor,drinking,.9
bottle,usedFor,drinking,.55
bowl,isNotA,dish,
a name of a thing that is much longer than any line of a telephone,usedFor,drinking,
lamp,https://example.org/a/long/address/without/any/space/usedForSomethingElse,lighting,
"""
QUESTIONS = (
    "usedFor drinking",
    "not isA dish",
    "is mug and hasColor red",
    "leftOf (is mug)",
    "",
)


@pytest.fixture(scope="module")
def asker(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "home.csv"
    path.write_text(GRAPH)
    asker = Asker(load_agent(RUN), path)
    yield asker
    asker.close()


@pytest.mark.parametrize(("question", "size"), combinations(QUESTIONS, SIZES))
def test_the_page_fits_the_screen(asker, open_page, tmp_path, question, size):  # noqa: F811
    asked = asker.ask(question) if question else None
    path = tmp_path / "page.html"
    path.write_text(page(asked, question, (), asker=asker), encoding="utf-8")
    opened = open_page(path, *size)
    width = opened.evaluate("document.documentElement.scrollWidth")
    assert width <= size[0]
    cut = opened.eval_on_selector_all(
        ".why td, .read dd, .examples a",
        "all => all.filter(e => e.getBoundingClientRect().right > innerWidth + 1)"
        ".map(e => e.textContent)",
    )
    assert cut == []
    if not question:
        return
    reading = opened.locator(".read dd").first.bounding_box()
    verdict = opened.locator(".verdict").bounding_box()
    answers = opened.locator(".why").bounding_box()
    assert reading["y"] < verdict["y"] < answers["y"]
    assert opened.locator(".basis").count() >= 1
    for tag in opened.locator(".basis").all():
        assert tag.bounding_box()["height"] < 40  # on one line
