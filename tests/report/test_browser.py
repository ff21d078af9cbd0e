"""The report in a real browser: opened from the disk, clicked through, with no network."""

import csv
import shutil
from pathlib import Path

import pytest

from knowarm.report import write_report
from tests.report.synthetic_study import Size, Truth, write_study
from tests.thorough import thorough

pytestmark = [pytest.mark.browser, pytest.mark.usefixtures("unfenced")]

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))),
    None,
)
FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
SIZES = [(1440, 900), (390, 844)]


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed"
    )
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine (Debian: apt-get install chromium)")
    with playwright.sync_playwright() as started:
        opened = started.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield opened
        opened.close()


@pytest.fixture
def open_page(browser):
    """Opens a file without network; fails the test on any error the browser reports."""
    contexts, complaints = [], []

    def opener(path: Path, width: int = 1440, height: int = 900, **options):
        context = browser.new_context(
            viewport={"width": width, "height": height}, offline=True, **options
        )
        contexts.append(context)
        page = context.new_page()
        page.on(
            "console",
            lambda message: complaints.append(f"{message.type}: {message.text}"),
        )
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("requestfailed", lambda request: complaints.append(request.url[:80]))
        page.goto(path.as_uri())
        return page

    yield opener
    for context in contexts:
        context.close()
    assert complaints == []


def visible_sections(page) -> list[str]:
    return page.eval_on_selector_all(
        "main > section",
        "all => all.filter(s => s.offsetParent !== null).map(s => s.id)",
    )


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_page_opens_and_fits_the_screen(made, open_page, size, scheme):
    page = open_page(made.page, *size, color_scheme=scheme)
    names = page.eval_on_selector_all("nav a", "all => all.map(a => a.hash.slice(1))")
    assert names[0] == "summary"
    assert {"inputs", "training", "results", "knowledge", "differences", "paper"} < set(
        names
    )
    for name in names:
        page.click(f"nav a[href='#{name}']")
        page.wait_for_function(
            "name => !document.getElementById(name).hidden", arg=name
        )
        assert visible_sections(page) == [name]
        assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
        assert page.evaluate("scrollY") == 0


def test_no_image_is_missing(made, open_page):
    page = open_page(made.page)
    widths = page.eval_on_selector_all("img", "all => all.map(i => i.naturalWidth)")
    assert len(widths) > 30
    assert min(widths) > 0
    empty = page.eval_on_selector_all(
        "svg.chart", "all => all.filter(s => s.childElementCount === 0).length"
    )
    assert empty == 0


def test_shown_values_equal_the_csv_files(made, open_page):
    page = open_page(made.page)
    name = "evaluation-irb120-fixed-colours-ppo"
    shown = page.eval_on_selector_all(
        f"table[data-table='{name}'] tbody tr",
        """rows => rows.map(
            row => Object.fromEntries([...row.cells].map(c => [c.dataset.k, c.dataset.v]))
        )""",
    )
    with (made.page.parent / "report-data" / f"{name}.csv").open(newline="") as file:
        written = list(csv.DictReader(file))
    assert shown == [{key: row[key] for key in shown[0]} for row in written]
    texts = page.eval_on_selector_all(
        f"table[data-table='{name}'] td[data-k=success]",
        "all => all.map(c => c.textContent)",
    )
    for text, row in zip(texts, written, strict=True):
        assert text.replace("\u202f", "").startswith(
            f"{float(row['success']) * 100:.1f}%"
        )


def test_pointing_at_a_curve_tells_its_values(made, open_page):
    page = open_page(made.page)
    page.click("nav a[href='#training']")
    chart = page.locator(".part:not([hidden]) .panel.large svg.lines").first
    box = chart.bounding_box()
    page.mouse.move(box["x"] + box["width"] * 0.7, box["y"] + box["height"] * 0.5)
    tip = page.locator(".tip")
    tip.wait_for(state="visible")
    assert "full" in tip.inner_text()
    page.locator("#training .part:not([hidden]) [data-toggle='full']").click()
    page.mouse.move(box["x"] + box["width"] * 0.6, box["y"] + box["height"] * 0.5)
    assert "full" not in tip.inner_text()
    page.mouse.move(2, 2)
    tip.wait_for(state="hidden")


def test_one_task_at_a_time_or_all(made, open_page):
    page = open_page(made.page)
    page.click("nav a[href='#results']")
    parts = "#results [data-part]:not([hidden])"
    assert page.locator(parts).count() == 1
    page.select_option("[data-tasks]", "tiago-randomized-colours-ppo")
    assert (
        page.locator(parts).get_attribute("data-part") == "tiago-randomized-colours-ppo"
    )
    page.select_option("[data-tasks]", "")
    assert page.locator(parts).count() == 2


def test_a_film_plays_and_stops(made, open_page):
    page = open_page(made.page)
    page.click("nav a[href='#episodes']")
    button = page.locator("[data-play]").first
    image = button.locator("img")
    assert image.get_attribute("src").startswith("data:image/png")
    button.click()
    assert image.get_attribute("src").startswith("data:image/webp")
    page.wait_for_function(
        "() => document.querySelector('[data-play] img').naturalWidth === 64"
    )
    button.click()
    assert image.get_attribute("src").startswith("data:image/png")


def test_the_colours_can_be_changed(made, open_page):
    page = open_page(made.page, color_scheme="light")
    background = "getComputedStyle(document.body).backgroundColor"
    light = page.evaluate(background)
    page.click("[data-theme-button]")
    assert page.evaluate(background) != light
    page.click("[data-theme-button]")
    assert page.evaluate(background) == light


def test_without_a_script_and_on_paper_everything_is_there(made, open_page):
    page = open_page(made.page, java_script_enabled=False)
    assert len(page.locator("main > section").all()) >= 9
    assert all(section.is_visible() for section in page.locator("main > section").all())
    printed = open_page(made.page)
    printed.emulate_media(media="print")
    assert all(
        section.is_visible() for section in printed.locator("main > section").all()
    )
    assert not printed.locator("header.top").is_visible()
    assert len(printed.pdf()) > 50_000


def test_many_runs_make_a_page_of_bounded_size(open_page, tmp_path):
    truth = Truth(
        success={"bm": 0.5, "partial": 0.55, "full": 0.7, "wide": 0.5, "random": 0.5}
    )
    size = Size(points=200, episodes=40, films=1, steps=True)
    seeds = thorough(2, 6)
    runs = []
    for colours in thorough(["fixed"], ["fixed", "randomized"]):
        options = {"seeds": seeds, "colours": colours, "size": size}
        runs += write_study(tmp_path / "runs", truth, **options)
    assert len(runs) == thorough(10, 60)
    out = write_report(runs, tmp_path / "report.html")
    # Seconds depend on who else uses the machine: what makes a page slow is its size, and that
    # nothing but drawing happens before it has loaded.
    assert out.stat().st_size < 100_000 * len(runs)
    page = open_page(out)
    page.wait_for_function("() => performance.timing.loadEventEnd > 0")
    assert page.evaluate("document.querySelectorAll('*').length") < 1_000 * len(runs)
    page.close()
